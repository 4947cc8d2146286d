//! The MCAP file of a record while it is written. It has another name until it is
//! complete, and never replaces another file.

use std::{
    collections::BTreeMap,
    ffi::OsString,
    fs::{self, File},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use mcap::{Compression, McapError, WriteOptions, Writer};

use super::RecordError;
use crate::Channel;

/// The profile in the header of the file: readers then expect ROS 2 messages.
pub(crate) const PROFILE: &str = "ros2";
/// The first word of the library in the header of our files.
pub(crate) const LIBRARY_NAME: &str = "singletrack";
/// The library in the header of the files that this version writes.
pub(crate) const LIBRARY: &str = concat!("singletrack ", env!("CARGO_PKG_VERSION"));

/// The name of the file at `path` until it is finished.
#[must_use]
pub fn part_path(path: &Path) -> PathBuf {
    with_suffix(path, ".part")
}

/// A path with a suffix after its name.
pub(crate) fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    PathBuf::from(name)
}

/// A file that is being written.
pub(crate) struct Container {
    path: PathBuf,
    part: PathBuf,
    writer: Writer<BufWriter<File>>,
    /// Another handle of the same file, to sync it.
    file: File,
}

impl Container {
    /// Starts the file that will be at `path`, under the name `part`.
    pub(crate) fn create(path: &Path, part: PathBuf) -> Result<Self, RecordError> {
        if path.exists() {
            return Err(RecordError::Exists(path.to_owned()));
        }
        let file = match File::create_new(&part) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                return Err(RecordError::Exists(part));
            }
            result => result.map_err(failure("create", &part))?,
        };
        // Held as long as the file is open, so that `recover` refuses it. Some file systems
        // have no locks: an error is ignored.
        let _ = file.try_lock();
        let handle = file.try_clone().map_err(failure("open", &part))?;
        let writer = WriteOptions::new()
            .profile(PROFILE)
            .library(LIBRARY)
            .compression(Some(Compression::Zstd))
            // The thread pool costs milliseconds per chunk.
            .compression_threads(0)
            // The recorder ends the chunks: see `end_chunk`.
            .chunk_size(None)
            // Otherwise an open chunk makes the whole file unreadable.
            .disable_seeking(true)
            .create(BufWriter::new(file))
            .map_err(|source| RecordError::Write {
                path: part.clone(),
                source: Box::new(source),
            })?;
        Ok(Self {
            path: path.to_owned(),
            part,
            writer,
            file: handle,
        })
    }

    /// Where the finished file will be.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The unfinished file.
    pub(crate) fn part(&self) -> &Path {
        &self.part
    }

    /// Calls `write` with the writer of the file.
    pub(crate) fn write<T>(
        &mut self,
        write: impl FnOnce(&mut Writer<BufWriter<File>>) -> Result<T, McapError>,
    ) -> Result<T, RecordError> {
        write(&mut self.writer).map_err(|source| RecordError::Write {
            path: self.part.clone(),
            source: Box::new(source),
        })
    }

    /// Writes the descriptions of all channels; returns their ids by [`Channel::index`].
    /// The ids are the same in every new file.
    pub(crate) fn describe(&mut self) -> Result<[u16; Channel::COUNT], RecordError> {
        let mut ids = [0; Channel::COUNT];
        self.write(|writer| {
            for (channel, id) in Channel::all().zip(&mut ids) {
                let schema = writer.add_schema(
                    &channel.schema_name(),
                    Channel::SCHEMA_ENCODING,
                    channel.schema_text().as_bytes(),
                )?;
                *id = writer.add_channel(
                    schema,
                    channel.topic(),
                    Channel::MESSAGE_ENCODING,
                    &BTreeMap::new(),
                )?;
            }
            Ok(())
        })?;
        Ok(ids)
    }

    /// Ends the chunk; the next message begins another one. A truncated file has a chunk
    /// whole or not at all.
    pub(crate) fn end_chunk(&mut self) -> Result<(), RecordError> {
        self.write(Writer::flush)
    }

    /// Writes everything so far to the disk, under the name that it had.
    pub(crate) fn flush(&mut self) -> Result<(), RecordError> {
        self.end_chunk()?;
        self.file.sync_data().map_err(failure("sync", &self.part))?;
        // A system writes to a removed file without an error, and throws it away at the end.
        match fs::exists(&self.part) {
            Ok(false) => Err(RecordError::Gone(self.part.clone())),
            _ => Ok(()),
        }
    }

    /// Completes the file and renames it to its final name; returns its size.
    pub(crate) fn finish(mut self) -> Result<u64, RecordError> {
        self.write(Writer::finish)?;
        let Self {
            path,
            part,
            writer,
            file,
        } = self;
        writer
            .into_inner()
            .flush()
            .map_err(failure("write", &part))?;
        file.sync_all().map_err(failure("sync", &part))?;
        let bytes = file.metadata().map_err(failure("look at", &part))?.len();
        if path.exists() {
            return Err(RecordError::Exists(path));
        }
        fs::rename(&part, &path).map_err(failure("rename", &part))?;
        Ok(bytes)
    }

    /// Removes the file.
    pub(crate) fn discard(self) -> Result<(), RecordError> {
        fs::remove_file(&self.part).map_err(failure("remove", &self.part))
    }
}

/// Adds operation and file to an error of the system.
pub(crate) fn failure(
    action: &'static str,
    path: &Path,
) -> impl Fn(io::Error) -> RecordError + use<> {
    let path = path.to_owned();
    move |source| RecordError::Io {
        action,
        path: path.clone(),
        source,
    }
}
