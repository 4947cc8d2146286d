//! Why a dump failed.

use std::{io, path::PathBuf};

use singletrack_api::ClientError;
use singletrack_record::{ParseEntryError, RecordError};
use singletrackd::serial_port::PortError;

use super::{moment::Moment, span::Span};

/// Why a dump failed.
#[derive(Debug, thiserror::Error)]
pub enum DumpError {
    /// The record can't be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The serial port can't be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The bytes of the line can't be read.
    #[error("can't read {name}: {source}")]
    Capture {
        /// The file or the port.
        name: String,
        /// Why it failed.
        source: io::Error,
    },
    /// The bytes are not those of the line.
    #[error(
        "{name} holds no whole frame of the protocol in {bytes} bytes: name a capture of the serial line (--direction says which way the bytes went), or a record (*.mcap or *.mcap.part)"
    )]
    NoFrames {
        /// The file.
        name: String,
        /// Its length.
        bytes: u64,
    },
    /// The source has no such topic.
    #[error("there is no topic {topic:?}{}: use {}", near(.similar), .known.join(", "))]
    UnknownTopic {
        /// The topic asked for.
        topic: String,
        /// A topic that may be meant.
        similar: Option<String>,
        /// All that there are.
        known: Vec<&'static str>,
    },
    /// None of the topics has such a field.
    #[error("{} has no field {field:?}{}; its fields are {}", .topics.join(", "), near(.similar), .known.join(", "))]
    UnknownField {
        /// The topics.
        topics: Vec<&'static str>,
        /// The field asked for.
        field: String,
        /// A field that may be meant.
        similar: Option<String>,
        /// All that there are.
        known: Vec<String>,
    },
    /// No value of the field is that word.
    #[error("{field} is never {word:?}; it is one of {}", .known.join(", "))]
    UnknownWord {
        /// The field.
        field: String,
        /// What it was compared with.
        word: String,
        /// The words that it can be.
        known: Vec<String>,
    },
    /// The time ends before it begins.
    #[error("--from {from} is after --to {to}: give the earlier time to --from{}", of_record(.span))]
    NoTime {
        /// When it begins.
        from: Moment,
        /// When it ends.
        to: Moment,
        /// The times of the record, if they are known.
        span: Option<Span>,
    },
    /// No entry of the record is in the range.
    #[error("--{option} {moment} leaves nothing of {name}: its entries are from {span}")]
    OutsideRecord {
        /// The record.
        name: String,
        /// Which option asked.
        option: &'static str,
        /// What it asked for.
        moment: Moment,
        /// The times of the record.
        span: Span,
    },
    /// The source has no time on the wall.
    #[error("{name} holds no wall time: give --{option} in seconds since its start")]
    NoWallTime {
        /// The source.
        name: String,
        /// Which option asked.
        option: &'static str,
    },
    /// Statistics have no rows.
    #[error("--stats has no csv: use --format table or --format json")]
    StatsAsCsv,
    /// Ctrl-C can't be listened for.
    #[error("can't listen for Ctrl-C: {0}")]
    Interrupt(#[source] io::Error),
    /// No process listens at the socket.
    #[error("can't reach the daemon at {}: {source}; start singletrackd, or name its socket with --socket", path.display())]
    Unreachable {
        /// The socket.
        path: PathBuf,
        /// Why it failed.
        source: io::Error,
    },
    /// The connection broke.
    #[error(transparent)]
    Lost(ClientError),
    /// The daemon refuses to send entries.
    #[error("the daemon at {} refuses: {error}", path.display())]
    Refused {
        /// The socket.
        path: PathBuf,
        /// Why, in its words.
        error: String,
    },
    /// The daemon sent a line that is not an entry.
    #[error("can't understand the daemon at {}: {source}; use the singletrack of its release", path.display())]
    Answer {
        /// The socket.
        path: PathBuf,
        /// What it said.
        source: ParseEntryError,
    },
    /// The output can't be written.
    #[error("can't write to standard output: {0}")]
    Output(#[from] io::Error),
}

fn of_record(span: &Option<Span>) -> String {
    span.map(|span| format!("; the entries of the record are from {span}"))
        .unwrap_or_default()
}

fn near(similar: &Option<String>) -> String {
    similar
        .as_ref()
        .map(|name| format!(" (did you mean {name:?}?)"))
        .unwrap_or_default()
}
