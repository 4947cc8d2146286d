//! What can go wrong with a record, and what to do about it.

use std::{io, path::PathBuf};

use crate::EncodeError;

/// A record cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file system says no.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was attempted.
        action: &'static str,
        /// With which file.
        path: PathBuf,
        /// Why it failed.
        source: io::Error,
    },
    /// A record is never overwritten.
    #[error("{} exists already and records are never overwritten: move it or choose another name", .0.display())]
    Exists(PathBuf),
    /// Somebody writes it.
    #[error("{} is being written: wait until its recorder has ended", .0.display())]
    Busy(PathBuf),
    /// The container could not be written.
    #[error("cannot write {}: {source}; what it holds up to the last second can be read", path.display())]
    Write {
        /// The unfinished file.
        path: PathBuf,
        /// Why it failed.
        source: Box<mcap::McapError>,
    },
    /// An entry could not be encoded.
    #[error("{source} for {}", path.display())]
    Encode {
        /// The unfinished file.
        path: PathBuf,
        /// Which message, and why.
        source: EncodeError,
    },
    /// The file is something else.
    #[error("{} is not an MCAP file: name a record written by singletrackd, simulate or demo (*.mcap or *.mcap.part)", .0.display())]
    NotMcap(PathBuf),
    /// An MCAP file that someone else wrote.
    #[error("{} is an MCAP file of \"{library}\" with profile \"{profile}\", not a record of Singletrack: open it with a viewer such as Foxglove or PlotJuggler", path.display())]
    NotOurs {
        /// The file.
        path: PathBuf,
        /// The profile in its header.
        profile: String,
        /// Who wrote it, by its header.
        library: String,
    },
    /// The file ends before anything was recorded.
    #[error("{} ends after {bytes} bytes, before its first entry: nothing was recorded", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// Its length.
        bytes: u64,
    },
    /// What the record says of itself does not make sense.
    #[error("the metadata of {} has {key} = {value:?}, which is not {expected}", path.display())]
    Metadata {
        /// The file.
        path: PathBuf,
        /// Which part of it.
        key: &'static str,
        /// What it says.
        value: String,
        /// What it should say.
        expected: &'static str,
    },
    /// Another generation of records.
    #[error("{} is a record of version {found}; this program reads version {known}: use the singletrack of the release that wrote it", path.display())]
    OtherVersion {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
        /// The version that can be read.
        known: u32,
    },
    /// A message has the known name and another layout.
    #[error("{} has another layout of {schema} than this program: use the singletrack of the release that wrote it", path.display())]
    OtherSchema {
        /// The file.
        path: PathBuf,
        /// The message.
        schema: String,
    },
    /// The file is damaged: more than merely cut off.
    #[error("{} is damaged after {entries} entries, within its first {bytes} bytes: {reason}; what comes before can be used, and `singletrack recover` saves what is whole after it", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Entries before the damage.
        entries: u64,
        /// How far the file had been read.
        bytes: u64,
        /// What is wrong.
        reason: String,
    },
    /// The writer's thread could not be started or has died.
    #[error("the thread that writes {} {what}", path.display())]
    Thread {
        /// The record.
        path: PathBuf,
        /// What happened.
        what: String,
    },
}
