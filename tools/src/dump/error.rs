//! Why nothing, or not everything, is printed.

use std::{io, path::PathBuf};

use singletrack_record::{NotAnEntry, RecordError, Topic};

/// A dump that failed.
#[derive(Debug, thiserror::Error)]
pub enum DumpError {
    /// The record cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The topic has no such field.
    #[error("{topic} has no field {field:?}{}; its fields are {}", near(.similar), .known.join(", "))]
    UnknownField {
        /// The topic.
        topic: Topic,
        /// The field asked for.
        field: String,
        /// A field that may be meant.
        similar: Option<String>,
        /// All of its fields.
        known: Vec<String>,
    },
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
        source: NotAnEntry,
    },
    /// The output cannot be written.
    #[error("cannot write to standard output: {0}")]
    Output(#[from] io::Error),
}

fn near(similar: &Option<String>) -> String {
    similar
        .as_ref()
        .map(|field| format!(" (did you mean {field:?}?)"))
        .unwrap_or_default()
}
