//! Writing a record.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use mcap::records::MessageHeader;

use crate::{Channel, Encoder, Entry, Meta, RecordError, container::Container, part_path};

/// When the process is killed, what came since the last flush is lost. Half of
/// the second that is promised: the other half is for a slow disk.
const FLUSH_PERIOD: Duration = Duration::from_millis(500);

/// A chunk of more, before it is compressed, is not added to.
const CHUNK_LENGTH: usize = 768 << 10;

/// Writes one record.
///
/// While it does, the file is called `NAME.mcap.part`; [`Recorder::finish`] gives
/// it its name. A recorder that is dropped or killed leaves the `.part`, which
/// [`crate::Reader`] reads as far as it goes, and [`crate::recover`] completes.
///
/// Twice a second it flushes and syncs, which may take as long as the disk likes:
/// it belongs on a thread of its own, such as a [`crate::RecorderThread`].
pub struct Recorder {
    container: Container,
    encoder: Encoder,
    channels: [WrittenChannel; Channel::COUNT],
    flushed: Instant,
    flush_period: Option<Duration>,
    unflushed: bool,
    /// Of the messages since the last chunk.
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
    /// Entries in it.
    pub entries: u64,
    /// Its size.
    pub bytes: u64,
}

impl Recorder {
    /// Starts the record that will be at `path`.
    ///
    /// # Errors
    ///
    /// When it or its unfinished file exists, or the file cannot be written.
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

    /// Does not flush by the clock, so that the same entries give the same bytes:
    /// for what can be recorded again, such as a simulation.
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

    /// Adds an entry, and flushes if the last flush is half a second ago.
    ///
    /// # Errors
    ///
    /// When the file cannot be written; all later calls fail as well.
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
        // Not before: what an entry becomes stays together.
        if self.chunk_length > CHUNK_LENGTH {
            self.chunk_length = 0;
            self.container.end_chunk()?;
        }
        self.flush_if_due()
    }

    /// Flushes if there is something to flush and the last flush is half a second
    /// ago. For whoever has no entry to write just now.
    ///
    /// # Errors
    ///
    /// When the file cannot be written.
    pub fn flush_if_due(&mut self) -> Result<(), RecordError> {
        let is_due = |period| self.flushed.elapsed() >= period;
        if self.unflushed && self.flush_period.is_some_and(is_due) {
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
        self.unflushed = false;
        self.chunk_length = 0;
        self.container.flush()
    }

    /// Completes the file and gives it its name.
    ///
    /// # Errors
    ///
    /// When that fails; the unfinished file then stays.
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
