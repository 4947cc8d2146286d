//! Writing a record.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use mcap::records::MessageHeader;

use super::{
    RecordError,
    container::{Container, part_path},
};
use crate::{Channel, Encoder, Entry, Meta};

/// A killed process loses the entries since the last flush. The documented limit is one
/// second; this leaves half of it for a slow disk.
const FLUSH_PERIOD: Duration = Duration::from_millis(500);

/// A chunk is ended when its messages have more bytes than this before compression.
const CHUNK_LENGTH: usize = 768 << 10;

/// Writes one record.
///
/// While it writes, the file has the name `NAME.mcap.part`; [`Recorder::finish`] renames
/// it. A recorder that is dropped or killed leaves the `.part` file, which
/// [`crate::Reader`] reads up to its end and [`crate::recover`] repairs.
///
/// It flushes and syncs twice a second, which may block for as long as the disk takes.
/// Run it on a thread of its own, such as a [`crate::RecorderThread`].
pub struct Recorder {
    container: Container,
    encoder: Encoder,
    channels: [WrittenChannel; Channel::COUNT],
    flushed: Instant,
    flush_period: Option<Duration>,
    unflushed: bool,
    /// Bytes of the messages since the last chunk.
    chunk_length: usize,
    entries: u64,
}

#[derive(Clone, Copy)]
struct WrittenChannel {
    id: u16,
    sequence: u32,
}

/// A finished record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finished {
    /// The file.
    pub path: PathBuf,
    /// The number of entries.
    pub entries: u64,
    /// The size of the file, in bytes.
    pub bytes: u64,
}

impl Recorder {
    /// Starts a record that will be at `path` once it is finished.
    ///
    /// # Errors
    ///
    /// When it or its unfinished file exists, or the file can't be written.
    pub fn create(path: &Path, meta: &Meta) -> Result<Self, RecordError> {
        let mut container = Container::create(path, part_path(path))?;
        container.write(|writer| {
            writer.write_metadata(&meta.to_metadata())?;
            writer.attach(&meta.to_attachment())
        })?;
        let channels = container
            .describe()?
            .map(|id| WrittenChannel { id, sequence: 0 });
        let mut recorder = Self {
            container,
            encoder: Encoder::new(meta.start),
            channels,
            flushed: Instant::now(),
            flush_period: Some(FLUSH_PERIOD),
            unflushed: false,
            chunk_length: 0,
            entries: 0,
        };
        recorder.flush()?;
        Ok(recorder)
    }

    /// Turns the flushes by the clock off, so that the same entries give the same bytes.
    /// For entries that can be recorded again, such as those of a simulation.
    #[must_use]
    pub const fn without_timed_flushes(mut self) -> Self {
        self.flush_period = None;
        self
    }

    /// Where the finished record will be.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.container.path()
    }

    /// Adds an entry, and flushes if the last flush is half a second old.
    ///
    /// # Errors
    ///
    /// When the file can't be written; later calls fail as well.
    pub fn write(&mut self, entry: &Entry) -> Result<(), RecordError> {
        let publications = self
            .encoder
            .encode(entry)
            .map_err(|source| RecordError::Encode {
                path: self.container.part().to_owned(),
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
            self.chunk_length += publication.bytes.len();
            self.container
                .write(|writer| writer.write_to_known_channel(&header, publication.bytes))?;
        }
        self.entries += 1;
        self.unflushed = true;
        // Only after the last message of the entry: its messages stay in one chunk.
        if self.chunk_length > CHUNK_LENGTH {
            self.chunk_length = 0;
            self.container.end_chunk()?;
        }
        self.flush_if_due()
    }

    /// Flushes if there are unflushed entries and the last flush is half a second old.
    /// Call it while there is no entry to write.
    ///
    /// # Errors
    ///
    /// When the file can't be written.
    pub fn flush_if_due(&mut self) -> Result<(), RecordError> {
        let is_due = |period| self.flushed.elapsed() >= period;
        if self.unflushed && self.flush_period.is_some_and(is_due) {
            self.flush()?;
        }
        Ok(())
    }

    /// Writes all entries so far to the disk: they survive a killed process and a loss of
    /// power.
    ///
    /// # Errors
    ///
    /// When the file can't be written.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.flushed = Instant::now();
        self.unflushed = false;
        self.chunk_length = 0;
        self.container.flush()
    }

    /// Completes the file and renames it to its final name.
    ///
    /// # Errors
    ///
    /// When that fails. The unfinished file is then kept.
    pub fn finish(self) -> Result<Finished, RecordError> {
        let path = self.container.path().to_owned();
        let bytes = self.container.finish()?;
        Ok(Finished {
            path,
            entries: self.entries,
            bytes,
        })
    }
}
