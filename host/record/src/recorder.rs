//! Writing a record.

use std::{
    collections::BTreeMap,
    ffi::OsString,
    fs::{self, File},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use mcap::{Compression, WriteOptions, Writer, records::MessageHeader};

use crate::{Channel, Encoder, Entry, Meta, RecordError};

/// The profile that tells readers to expect ROS 2 messages.
pub(crate) const PROFILE: &str = "ros2";
/// Who wrote the file. Readers of records look for the first word.
pub(crate) const LIBRARY: &str = concat!("singletrack ", env!("CARGO_PKG_VERSION"));

/// No more than this is lost when the process is killed.
const FLUSH_PERIOD: Duration = Duration::from_secs(1);

/// Writes one record.
///
/// While it does, the file is called `NAME.mcap.part`; [`Recorder::finish`] gives
/// it its name. A recorder that is dropped or killed leaves the `.part`, which
/// [`crate::Reader`] reads as far as it goes.
///
/// Every second it flushes and syncs, which may take as long as the disk likes:
/// it belongs on a thread of its own, such as a [`crate::RecorderThread`].
pub struct Recorder {
    path: PathBuf,
    part: PathBuf,
    writer: Writer<BufWriter<File>>,
    /// Another handle of the same file, to sync it.
    file: File,
    encoder: Encoder,
    channels: [WrittenChannel; Channel::COUNT],
    flushed: Instant,
    entries: u64,
}

#[derive(Clone, Copy, Default)]
struct WrittenChannel {
    id: u16,
    sequence: u32,
}

/// A finished record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finished {
    /// The file.
    pub path: PathBuf,
    /// Entries in it.
    pub entries: u64,
    /// Its size.
    pub bytes: u64,
}

/// What the file at `path` is called until it is finished.
#[must_use]
pub fn part_path(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".part");
    PathBuf::from(name)
}

impl Recorder {
    /// Starts the record that will be at `path`.
    ///
    /// # Errors
    ///
    /// When it or its unfinished file exists, or the file cannot be written.
    pub fn create(path: &Path, meta: &Meta) -> Result<Self, RecordError> {
        let part = part_path(path);
        if path.exists() {
            return Err(RecordError::Exists(path.to_owned()));
        }
        let file = match File::create_new(&part) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                return Err(RecordError::Exists(part));
            }
            result => result.map_err(failure("create", &part))?,
        };
        let handle = file.try_clone().map_err(failure("open", &part))?;
        let written = write_failure(&part);
        let mut writer = WriteOptions::new()
            .profile(PROFILE)
            .library(LIBRARY)
            .compression(Some(Compression::Zstd))
            // The thread pool costs milliseconds a chunk.
            .compression_threads(0)
            // Otherwise an open chunk makes the whole file unreadable.
            .disable_seeking(true)
            .create(BufWriter::new(file))
            .map_err(&written)?;
        writer
            .write_metadata(&meta.to_metadata())
            .map_err(&written)?;
        writer.attach(&meta.to_attachment()).map_err(&written)?;
        let mut channels = [WrittenChannel::default(); Channel::COUNT];
        for (channel, written_channel) in Channel::all().zip(&mut channels) {
            let schema = writer
                .add_schema(
                    &channel.schema_name(),
                    Channel::SCHEMA_ENCODING,
                    channel.schema_text().as_bytes(),
                )
                .map_err(&written)?;
            written_channel.id = writer
                .add_channel(
                    schema,
                    channel.topic(),
                    Channel::MESSAGE_ENCODING,
                    &BTreeMap::new(),
                )
                .map_err(&written)?;
        }
        let mut recorder = Self {
            path: path.to_owned(),
            part,
            writer,
            file: handle,
            encoder: Encoder::new(meta.start),
            channels,
            flushed: Instant::now(),
            entries: 0,
        };
        recorder.flush()?;
        Ok(recorder)
    }

    /// Where the finished record will be.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Adds an entry, and flushes if the last flush is a second ago.
    ///
    /// # Errors
    ///
    /// When the file cannot be written; all later calls fail as well.
    pub fn write(&mut self, entry: &Entry) -> Result<(), RecordError> {
        let publications = self
            .encoder
            .encode(entry)
            .map_err(|source| RecordError::Encode {
                path: self.part.clone(),
                source,
            })?;
        for publication in publications {
            let Some(channel) = self.channels.get_mut(publication.channel.index()) else {
                continue;
            };
            let header = MessageHeader {
                channel_id: channel.id,
                sequence: channel.sequence,
                log_time: publication.log_time_ns,
                publish_time: publication.publish_time_ns,
            };
            channel.sequence = channel.sequence.wrapping_add(1);
            self.writer
                .write_to_known_channel(&header, publication.bytes)
                .map_err(write_failure(&self.part))?;
        }
        self.entries += 1;
        if self.flushed.elapsed() >= FLUSH_PERIOD {
            self.flush()?;
        }
        Ok(())
    }

    /// Makes everything so far survive the end of the process and of the power.
    ///
    /// # Errors
    ///
    /// When the file cannot be written.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.flushed = Instant::now();
        self.writer.flush().map_err(write_failure(&self.part))?;
        self.file.sync_data().map_err(failure("sync", &self.part))
    }

    /// Completes the file and gives it its name.
    ///
    /// # Errors
    ///
    /// When that fails; the unfinished file then stays.
    pub fn finish(self) -> Result<Finished, RecordError> {
        let Self {
            path,
            part,
            mut writer,
            file,
            entries,
            ..
        } = self;
        writer.finish().map_err(write_failure(&part))?;
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
        Ok(Finished {
            path,
            entries,
            bytes,
        })
    }
}

fn failure(action: &'static str, path: &Path) -> impl Fn(io::Error) -> RecordError + use<> {
    let path = path.to_owned();
    move |source| RecordError::Io {
        action,
        path: path.clone(),
        source,
    }
}

fn write_failure(path: &Path) -> impl Fn(mcap::McapError) -> RecordError + use<> {
    let path = path.to_owned();
    move |source| RecordError::Write {
        path: path.clone(),
        source: Box::new(source),
    }
}
