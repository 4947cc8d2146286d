//! The metadata of a record in its file, and what the summary at the end of a finished one says of it.

use std::{
    borrow::Cow,
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::Path,
};

use mcap::{
    Attachment,
    records::{Metadata, Record, Statistics, op},
};

use super::{
    RecordError,
    chunk::{parse_record, split_record},
};
use crate::{ClockMapping, Meta, RECORD_VERSION, Topic};

/// Name of the metadata in the file.
pub(crate) const METADATA_NAME: &str = "singletrack";
/// Name of the attachment in the file.
pub(crate) const CONFIGURATION_NAME: &str = "configuration.toml";

const SOFTWARE_PREFIX: &str = "software.";

impl Meta {
    pub(crate) fn to_metadata(&self) -> Metadata {
        let numbers = [
            ("record_version", RECORD_VERSION.into()),
            ("protocol_version", self.protocol_version.into()),
            ("start_monotonic_ns", self.start.monotonic_ns),
            ("start_wall_ns", self.start.wall_ns),
        ];
        let numbers = numbers
            .into_iter()
            .chain(self.seed.map(|seed| ("seed", seed)));
        let numbers = numbers.map(|(key, number): (_, u64)| (key.to_owned(), number.to_string()));
        let software = self.software.iter().map(|(component, version)| {
            let key = format!("{SOFTWARE_PREFIX}{component}");
            (key, version.clone())
        });
        Metadata {
            name: METADATA_NAME.to_owned(),
            metadata: numbers.chain(software).collect(),
        }
    }

    pub(crate) fn to_attachment(&self) -> Attachment<'_> {
        Attachment {
            log_time: self.start.wall_ns,
            create_time: self.start.wall_ns,
            name: CONFIGURATION_NAME.to_owned(),
            media_type: "application/toml".to_owned(),
            data: Cow::Borrowed(self.configuration.as_bytes()),
        }
    }

    pub(crate) fn from_parts(
        path: &Path,
        metadata: &Metadata,
        configuration: &[u8],
    ) -> Result<Self, RecordError> {
        let number = |key| number(path, metadata, key);
        let protocol_version = number("protocol_version")?;
        let software = metadata.metadata.iter().filter_map(|(key, version)| {
            let component = key.strip_prefix(SOFTWARE_PREFIX)?;
            Some((component.to_owned(), version.clone()))
        });
        let seed = metadata.metadata.get("seed").map(|_| number("seed"));
        Ok(Self {
            configuration: std::str::from_utf8(configuration)
                .map_err(|_| {
                    let value = String::from_utf8_lossy(configuration);
                    unusable(path, CONFIGURATION_NAME, &value, "UTF-8")
                })?
                .to_owned(),
            software: software.collect(),
            protocol_version: u16::try_from(protocol_version).map_err(|_| {
                let value = protocol_version.to_string();
                unusable(path, "protocol_version", &value, "a number up to 65535")
            })?,
            seed: seed.transpose()?,
            start: ClockMapping {
                monotonic_ns: number("start_monotonic_ns")?,
                wall_ns: number("start_wall_ns")?,
            },
        })
    }
}

/// Refuses records of another version.
pub(crate) fn check_version(path: &Path, metadata: &Metadata) -> Result<(), RecordError> {
    let found = number(path, metadata, "record_version")?;
    if found == u64::from(RECORD_VERSION) {
        return Ok(());
    }
    let why = format!(
        "{} is a record of version {found}; this program reads version {RECORD_VERSION}: use the \
         singletrack of the release that wrote it",
        path.display()
    );
    Err(RecordError::Invalid(why))
}

fn number(path: &Path, metadata: &Metadata, key: &'static str) -> Result<u64, RecordError> {
    let value = metadata.metadata.get(key).map_or("", String::as_str);
    value
        .parse()
        .map_err(|_| unusable(path, key, value, "a number"))
}

fn unusable(path: &Path, key: &str, value: &str, expected: &str) -> RecordError {
    let path = path.display();
    RecordError::Invalid(format!(
        "the metadata of {path} has {key} = {value:?}, which is not {expected}"
    ))
}

/// The footer: opcode, length and contents, and the bytes after which a file ends.
const FOOTER: usize = 1 + 8 + 20;
const TAIL: usize = FOOTER + mcap::MAGIC.len();
/// A summary that is longer is not read: it belongs to a record of months.
const MAX_SUMMARY: u64 = 64 << 20;

/// The wall time of the first and the last message, in ns since 1970; none if the file is
/// unfinished, has no message, or has no such summary.
pub(crate) fn span_wall_ns(path: &Path) -> Option<[u64; 2]> {
    let summary = summary(path)?;
    let statistics = records(&summary).find_map(statistics)?;
    (statistics.message_count > 0)
        .then_some([statistics.message_start_time, statistics.message_end_time])
}

/// The number of messages of a topic; none if the file is unfinished, or has no such summary.
pub(crate) fn message_count(path: &Path, topic: Topic) -> Option<u64> {
    let summary = summary(path)?;
    let channel = records(&summary).find_map(|record| match record {
        Record::Channel(channel) => {
            (Topic::of_channel(&channel.topic) == Some(topic)).then_some(channel.id)
        }
        _ => None,
    })?;
    let counts = records(&summary)
        .find_map(statistics)?
        .channel_message_counts;
    Some(counts.get(&channel).copied().unwrap_or(0))
}

fn statistics(record: Record<'_>) -> Option<Statistics> {
    match record {
        Record::Statistics(statistics) => Some(statistics),
        _ => None,
    }
}

/// The summary of a finished file.
fn summary(path: &Path) -> Option<Vec<u8>> {
    let mut file = File::open(path).ok()?;
    let length = file.seek(SeekFrom::End(0)).ok()?;
    let footer_at = length.checked_sub(TAIL as u64)?;
    file.seek(SeekFrom::Start(footer_at)).ok()?;
    let mut tail = [0; TAIL];
    file.read_exact(&mut tail).ok()?;
    let (footer, magic) = tail.split_at_checked(FOOTER)?;
    let (opcode, content) = split_record(&mut &*footer)?;
    if magic != mcap::MAGIC || opcode != op::FOOTER {
        return None;
    }
    let summary_at = u64::from_le_bytes(*content.first_chunk()?);
    let summary_length = footer_at.checked_sub(summary_at)?;
    if summary_at == 0 || summary_length > MAX_SUMMARY {
        return None;
    }
    file.seek(SeekFrom::Start(summary_at)).ok()?;
    let mut summary = vec![0; usize::try_from(summary_length).ok()?];
    file.read_exact(&mut summary).ok()?;
    Some(summary)
}

/// The channels and the statistics of a summary.
fn records(summary: &[u8]) -> impl Iterator<Item = Record<'_>> {
    let mut rest = summary;
    core::iter::from_fn(move || split_record(&mut rest))
        .filter(|(opcode, _)| matches!(*opcode, op::CHANNEL | op::STATISTICS))
        .filter_map(|(opcode, content)| parse_record(opcode, content).ok())
}
