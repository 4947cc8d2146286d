//! Repair of a record that a killed recorder left, or that was damaged later.

mod scan;

use std::{
    collections::HashMap,
    fmt,
    fs::{self, File, TryLockError},
    mem,
    path::Path,
    time::Duration,
};

use mcap::{
    Attachment,
    records::{MessageHeader, Metadata, Record, op},
};
use scan::{Found, Scan};

use super::{
    RecordError,
    chunk::{Chunk, is_data_part, parse_record},
    metadata::{CONFIGURATION_NAME, METADATA_NAME},
    recorder::{Container, LIBRARY, LIBRARY_NAME, PROFILE, failure, with_suffix},
};
use crate::{Channel, Topic};

/// What was saved of a record, and what was lost.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recovery {
    /// Messages saved, on all channels.
    pub messages: u64,
    /// The number of entries among them, which a [`crate::Reader`] reads.
    pub entries: u64,
    /// Earliest and latest log time of the messages saved, in ns since 1970.
    pub span_ns: Option<(u64, u64)>,
    /// Length of the new file, in bytes.
    pub bytes: u64,
    /// Whether the record was complete to its end.
    pub complete: bool,
    /// Damaged places within the record.
    pub damaged_places: u64,
    /// Bytes lost there.
    pub damaged_bytes: u64,
    /// Bytes at the end that are no whole part of the record.
    pub cut_bytes: u64,
    /// Messages lost because the description of their channel is lost.
    pub nameless: u64,
    /// Whether the metadata was saved. Without it, other tools open the record and a
    /// [`crate::Reader`] does not.
    pub has_metadata: bool,
    /// Whether the configuration was saved. Without it, the same holds.
    pub has_configuration: bool,
    /// Missing messages, by the sequence numbers of those around them.
    pub missing: u64,
}

impl Recovery {
    /// Time from the first to the last message saved.
    pub fn duration(&self) -> Duration {
        self.span_ns.map_or(Duration::ZERO, |(first, last)| {
            Duration::from_nanos(last.saturating_sub(first))
        })
    }

    /// The metadata of the new file on the repair.
    fn to_metadata(&self) -> Metadata {
        let figures = [
            ("complete", u64::from(self.complete)),
            ("damaged_places", self.damaged_places),
            ("damaged_bytes", self.damaged_bytes),
            ("cut_bytes", self.cut_bytes),
            ("messages_without_topic", self.nameless),
            ("messages_missing", self.missing),
        ];
        Metadata {
            name: "singletrack_recovery".to_owned(),
            metadata: figures
                .map(|(key, value)| (key.to_owned(), value.to_string()))
                .into(),
        }
    }

    /// Whether the record was complete and undamaged.
    pub fn nothing_lost(&self) -> bool {
        self.losses().is_empty()
    }

    /// What was lost, in words.
    fn losses(&self) -> Vec<String> {
        let no_settings = !(self.has_metadata && self.has_configuration);
        let (places, cut) = (self.damaged_places, self.cut_bytes);
        [
            (places > 0).then(|| format!("{} bytes in {places} damaged places", self.damaged_bytes)),
            (self.nameless > 0).then(|| format!("{} messages whose topic is unknown", self.nameless)),
            no_settings.then(|| {
                "the metadata or the configuration: other tools open the record, singletrack does not"
                    .to_owned()
            }),
            (self.missing > 0)
                .then(|| format!("{} messages between others, by their numbers", self.missing)),
            (!self.complete).then(|| {
                format!(
                    "the end: {cut} bytes are not whole, and up to a second before the recorder \
                     stopped may be missing"
                )
            }),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

impl fmt::Display for Recovery {
    /// Writes what was saved on one line, and what was lost on the next ones.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            formatter,
            "saved {} entries ({} messages) of {:.2} s",
            self.entries,
            self.messages,
            self.duration().as_secs_f64()
        )?;
        match &*self.losses() {
            [] => formatter.write_str("\nlost nothing"),
            losses => losses
                .iter()
                .try_for_each(|loss| write!(formatter, "\nlost {loss}")),
        }
    }
}

/// Writes the readable part of the record at `input` to a new one at `output`, with the
/// index that tools expect. The old file is not changed. Messages are copied unchanged,
/// also those of other versions of records. Nothing of a damaged chunk is copied. The
/// metadata of the new file says what it lacks. `progress` is called with the bytes done
/// and the bytes in all.
///
/// # Errors
///
/// When one of the files can't be read or written, `input` is still being written,
/// `output` exists, or nothing was recorded. Then no new file is left.
pub fn recover(
    input: &Path,
    output: &Path,
    mut progress: impl FnMut(u64, u64),
) -> Result<Recovery, RecordError> {
    let file = File::open(input).map_err(failure("open", input))?;
    // A recorder holds the lock as long as it writes.
    if matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)) {
        return Err(RecordError::Busy(input.to_owned()));
    }
    let mut scan = Scan::new(file).map_err(failure("read", input))?;
    let library = check_head(input, &mut scan)?;
    let recovering = with_suffix(output, ".recovering");
    remove_left(&recovering)?;
    let mut salvage = Salvage {
        container: Container::create(output, recovering)?,
        schemas: HashMap::new(),
        channels: HashMap::new(),
        chunk: Chunk::default(),
        describes: library == LIBRARY,
        recovery: Recovery::default(),
    };
    let result = salvage.all(input, &mut scan, &mut progress);
    let (mut container, mut recovery) = (salvage.container, salvage.recovery);
    if let Err(error) = result {
        container.discard()?;
        return Err(error);
    }
    if recovery.messages == 0 {
        container.discard()?;
        return Err(RecordError::Empty {
            path: input.to_owned(),
            bytes: scan.length,
        });
    }
    let metadata = recovery.to_metadata();
    container.write(|writer| writer.write_metadata(&metadata))?;
    recovery.bytes = container.finish()?;
    Ok(recovery)
}

/// Removes what a repair that was killed has left; not that of one that is under way.
fn remove_left(recovering: &Path) -> Result<(), RecordError> {
    let Ok(file) = File::open(recovering) else {
        return Ok(());
    };
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Err(RecordError::Busy(recovering.to_owned())),
        _ => fs::remove_file(recovering).map_err(failure("remove", recovering)),
    }
}

/// Refuses a file that is not a record, with the errors of a reader; returns the library
/// that wrote the file.
fn check_head(input: &Path, scan: &mut Scan) -> Result<String, RecordError> {
    let length = scan.length;
    let empty = || RecordError::Empty {
        path: input.to_owned(),
        bytes: length,
    };
    if length < mcap::MAGIC.len() as u64 {
        return Err(empty());
    }
    if !scan.magic().map_err(failure("read", input))? {
        return Err(RecordError::NotMcap(input.to_owned()));
    }
    match scan.next().map_err(failure("read", input))? {
        Found::Record { opcode, content } => match parse_record(opcode, content) {
            Ok(Record::Header(header))
                if header.profile == PROFILE && header.library.starts_with(LIBRARY_NAME) =>
            {
                Ok(header.library)
            }
            Ok(Record::Header(header)) => Err(RecordError::NotOurs {
                path: input.to_owned(),
                profile: header.profile,
                library: header.library,
            }),
            _ => Err(RecordError::NotMcap(input.to_owned())),
        },
        Found::Nothing | Found::End => Err(empty()),
    }
}

/// The new file, and what has been copied to it.
struct Salvage {
    container: Container,
    /// New ids by old ones: a file may describe a schema or a channel twice.
    schemas: HashMap<u16, u16>,
    channels: HashMap<u16, NewChannel>,
    chunk: Chunk,
    /// Whether this version wrote the file and so knows its channels.
    describes: bool,
    recovery: Recovery,
}

#[derive(Clone, Copy)]
struct NewChannel {
    id: u16,
    /// Whether its messages are entries.
    entries: bool,
    /// Sequence number of the next message; none before the first, which has 0.
    next: Option<u32>,
}

/// Why a part of the old file is not copied.
enum NotCopied {
    Damaged,
    Failed(RecordError),
}

impl From<RecordError> for NotCopied {
    fn from(error: RecordError) -> Self {
        Self::Failed(error)
    }
}

impl Salvage {
    fn all(
        &mut self,
        input: &Path,
        scan: &mut Scan,
        progress: &mut impl FnMut(u64, u64),
    ) -> Result<(), RecordError> {
        let length = scan.length;
        // Bytes lost since the last whole part. At the end of the file they are a cut.
        let mut lost = 0;
        loop {
            let from = scan.at;
            progress(from, length);
            let refused = match scan.next().map_err(failure("read", input))? {
                Found::End => break,
                Found::Nothing => true,
                Found::Record { opcode, content } => match self.part(opcode, content) {
                    Ok(()) => false,
                    Err(NotCopied::Failed(error)) => return Err(error),
                    Err(NotCopied::Damaged) => true,
                },
            };
            if refused {
                scan.resume(from).map_err(failure("read", input))?;
                lost += scan.at - from;
            } else if lost > 0 {
                self.recovery.damaged_places += 1;
                self.recovery.damaged_bytes += lost;
                lost = 0;
            }
            if self.recovery.complete {
                break;
            }
        }
        self.recovery.cut_bytes = lost;
        progress(length, length);
        Ok(())
    }

    /// Copies one part of the file.
    fn part(&mut self, opcode: u8, content: &[u8]) -> Result<(), NotCopied> {
        if !is_data_part(opcode, content) {
            return Err(NotCopied::Damaged);
        }
        match opcode {
            op::CHUNK => {
                let mut chunk = mem::take(&mut self.chunk);
                let copied = self.chunk(&mut chunk, content);
                self.chunk = chunk;
                copied
            }
            op::DATA_END => {
                self.recovery.complete = true;
                Ok(())
            }
            _ => self.record(opcode, content),
        }
    }

    /// Copies the records of a chunk, once its checksum has been verified.
    fn chunk(&mut self, chunk: &mut Chunk, content: &[u8]) -> Result<(), NotCopied> {
        chunk.open_part(content).or(Err(NotCopied::Damaged))?;
        while let Some(record) = chunk.next() {
            let (opcode, data) = record.or(Err(NotCopied::Damaged))?;
            self.record(opcode, data)?;
        }
        // The messages of a chunk stay in one chunk.
        self.container.end_chunk()?;
        Ok(())
    }

    fn record(&mut self, opcode: u8, content: &[u8]) -> Result<(), NotCopied> {
        match &parse_record(opcode, content).or(Err(NotCopied::Damaged))? {
            Record::Metadata(metadata) => {
                self.recovery.has_metadata |= metadata.name == METADATA_NAME;
                self.container
                    .write(|writer| writer.write_metadata(metadata))?;
            }
            Record::Attachment { header, data, .. } => {
                self.recovery.has_configuration |= header.name == CONFIGURATION_NAME;
                let attachment = Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name.clone(),
                    media_type: header.media_type.clone(),
                    data: data.clone(),
                };
                self.container.write(|writer| writer.attach(&attachment))?;
            }
            Record::Schema { header, data } => {
                let id = self
                    .container
                    .write(|writer| writer.add_schema(&header.name, &header.encoding, data))?;
                self.schemas.insert(header.id, id);
            }
            Record::Channel(channel) => {
                let schema = match channel.schema_id {
                    0 => 0,
                    id => *self.schemas.get(&id).ok_or(NotCopied::Damaged)?,
                };
                let id = self.container.write(|writer| {
                    writer.add_channel(
                        schema,
                        &channel.topic,
                        &channel.message_encoding,
                        &channel.metadata,
                    )
                })?;
                let entries = Topic::of_channel(&channel.topic).is_some();
                let new = NewChannel {
                    id,
                    entries,
                    next: None,
                };
                // A channel that is described again keeps its count.
                self.channels.entry(channel.id).or_insert(new).id = id;
            }
            Record::Message { header, data } => self.message(header, data)?,
            // The new file gets its own indexes and summary.
            _ => {}
        }
        Ok(())
    }

    /// Describes the channels when their description is lost: they are the same in every
    /// file of this version.
    fn describe(&mut self) -> Result<(), RecordError> {
        let ids = self.container.describe()?;
        for (channel, id) in Channel::all().zip(ids) {
            let new = NewChannel {
                id,
                entries: matches!(channel, Channel::Entry(_)),
                next: None,
            };
            self.channels.insert(id, new);
        }
        Ok(())
    }

    fn message(&mut self, header: &MessageHeader, data: &[u8]) -> Result<(), RecordError> {
        if self.channels.is_empty() && self.describes {
            self.describe()?;
        }
        let Some(channel) = self.channels.get_mut(&header.channel_id) else {
            self.recovery.nameless += 1;
            return Ok(());
        };
        let ahead = header.sequence.wrapping_sub(channel.next.unwrap_or(0));
        // A number that goes back is of another recorder.
        if i32::try_from(ahead).is_ok() {
            self.recovery.missing += u64::from(ahead);
        }
        channel.next = Some(header.sequence.wrapping_add(1));
        let header = MessageHeader {
            channel_id: channel.id,
            ..*header
        };
        self.container
            .write(|writer| writer.write_to_known_channel(&header, data))?;
        let recovery = &mut self.recovery;
        recovery.messages += 1;
        recovery.entries += u64::from(channel.entries);
        let time = header.log_time;
        recovery.span_ns = Some(match recovery.span_ns {
            Some((first, last)) => (first.min(time), last.max(time)),
            None => (time, time),
        });
        Ok(())
    }
}
