//! What the summary at the end of a finished record says of it.

use std::{
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::Path,
};

use mcap::records::{Record, Statistics, op};

use super::parse::parse_record;
use crate::Topic;

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
    let (opcode, content) = next(&mut &*footer)?;
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
    core::iter::from_fn(move || next(&mut rest))
        .filter(|(opcode, _)| matches!(*opcode, op::CHANNEL | op::STATISTICS))
        .filter_map(|(opcode, content)| parse_record(opcode, content).ok())
}

/// The next part of a summary: its opcode and its content.
fn next<'a>(rest: &mut &'a [u8]) -> Option<(u8, &'a [u8])> {
    let (&opcode, after) = rest.split_first()?;
    let (length, after) = after.split_first_chunk()?;
    let (content, after) =
        after.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    *rest = after;
    Some((opcode, content))
}
