//! Records in files: writer, reader and recovery, and their errors.

mod chunk;
mod metadata;
mod reader;
mod recorder;
mod recover;

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

pub use chunk::parse_record;
pub use reader::{Ending, Reader, Recorded};
pub use recorder::{FeedInput, FeedOutput, Finished, Recorder, RecorderThread, feed, part_path};
pub use recover::{Recovery, recover};

/// Replaces a file as a whole: after a loss of power it is the old one or the new one. The new text
/// is first written to `FILE.new`, beside it.
///
/// # Errors
///
/// The system's error: the file is as before.
pub fn replace(path: &Path, text: &[u8]) -> io::Result<()> {
    let staged = path.with_added_extension("new");
    let mut file = File::create(&staged)?;
    file.write_all(text)?;
    file.sync_all()?;
    put_in_place(&staged, path)
}

/// Gives a file that is on the disk the name of the one that it replaces, down to the disk.
///
/// # Errors
///
/// The system's error.
pub fn put_in_place(staged: &Path, path: &Path) -> io::Result<()> {
    fs::rename(staged, path)?;
    // The new name itself must survive a loss of power, too.
    let folder = path.parent().filter(|it| *it != Path::new(""));
    File::open(folder.unwrap_or(Path::new(".")))?.sync_all()
}

/// A record can't be written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// An operation on the file failed.
    #[error("can't {action} {}: {source}", path.display())]
    Io {
        /// The operation.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The reason.
        source: io::Error,
    },
    /// The file exists, and records are never overwritten.
    #[error("{} exists already and records are never overwritten: move it or choose another name", .0.display())]
    Exists(PathBuf),
    /// The unfinished file, or its folder, was removed or moved.
    #[error("{} was removed or moved while it was written: nothing is recorded any more", .0.display())]
    Gone(PathBuf),
    /// Another process is writing the record.
    #[error("{} is being written: wait until its recorder has ended", .0.display())]
    Busy(PathBuf),
    /// The container could not be written.
    #[error("can't write {}: {source}; its entries up to the last second can be read", path.display())]
    Write {
        /// The unfinished file.
        path: PathBuf,
        /// The reason.
        source: Box<mcap::McapError>,
    },
    /// The file is not an MCAP file.
    #[error("{} is not an MCAP file: name a record written by singletrackd, simulate or demo (*.mcap or *.mcap.part)", .0.display())]
    NotMcap(PathBuf),
    /// The file is an MCAP file of another program.
    #[error("{} is an MCAP file of \"{library}\" with profile \"{profile}\", not a record of Singletrack: open it with a viewer such as Foxglove or PlotJuggler", path.display())]
    NotOurs {
        /// The file.
        path: PathBuf,
        /// The profile in its header.
        profile: String,
        /// The library in its header.
        library: String,
    },
    /// The file ends before its first entry.
    #[error("{} ends after {bytes} bytes, before its first entry: nothing was recorded", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// Its length.
        bytes: u64,
    },
    /// An entry could not be encoded, or the record has another version, layout or metadata than
    /// this program knows.
    #[error("{0}")]
    Invalid(String),
    /// The file is damaged, and not only truncated.
    #[error("{} is damaged after {entries} entries, within its first {bytes} bytes: {reason}; the entries before can be used, and `singletrack recover` saves the undamaged ones after it", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Entries before the damage.
        entries: u64,
        /// Bytes read up to there.
        bytes: u64,
        /// The kind of damage.
        reason: String,
    },
    /// The thread of the writer could not be started, or panicked.
    #[error("the thread that writes {} {what}", path.display())]
    Thread {
        /// The record.
        path: PathBuf,
        /// What happened.
        what: String,
    },
}
