//! Why nothing, or not everything, is printed.

use std::{io, path::PathBuf};

use singletrack_record::{ParseEntryError, RecordError};
use singletrackd::serial_port::PortError;

/// A dump that failed.
#[derive(Debug, thiserror::Error)]
pub enum DumpError {
    /// The record cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The serial port cannot be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The bytes of the line cannot be read.
    #[error("cannot read {name}: {source}")]
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
    /// The source cannot tell when that was.
    #[error("{name} holds no wall time: give --{option} in seconds since its start")]
    NoWallTime {
        /// The source.
        name: String,
        /// Which option asked.
        option: &'static str,
    },
    /// Statistics are no rows.
    #[error("--stats has no csv: use --format table or --format json")]
    StatsAsCsv,
    /// Ctrl-C cannot be listened for.
    #[error("cannot listen for Ctrl-C: {0}")]
    Interrupt(#[source] io::Error),
    /// Nobody answers at the socket.
    #[error("cannot reach the daemon at {}: {source}; start singletrackd, or name its socket with --socket", path.display())]
    Unreachable {
        /// The socket.
        path: PathBuf,
        /// Why it failed.
        source: io::Error,
    },
    /// The connection broke.
    #[error("lost the daemon at {}: {source}", path.display())]
    Lost {
        /// The socket.
        path: PathBuf,
        /// Why it failed.
        source: io::Error,
    },
    /// The daemon will not tell.
    #[error("the daemon at {} refuses: {error}", path.display())]
    Refused {
        /// The socket.
        path: PathBuf,
        /// Why, in its words.
        error: String,
    },
    /// The daemon does not send entries.
    #[error("the daemon at {} answered something {source}; if it is another release, use its own singletrack", path.display())]
    Answer {
        /// The socket.
        path: PathBuf,
        /// What it said.
        source: ParseEntryError,
    },
    /// The output cannot be written.
    #[error("cannot write to standard output: {0}")]
    Output(#[from] io::Error),
}

fn near(similar: &Option<String>) -> String {
    similar
        .as_ref()
        .map(|name| format!(" (did you mean {name:?}?)"))
        .unwrap_or_default()
}
