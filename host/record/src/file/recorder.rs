//! Writing a record. Its MCAP file has another name until it is complete, and never replaces another
//! file. On a thread of its own, behind bounded rings, producers never wait, and entries that find a ring
//! full are counted.

use std::{
    collections::BTreeMap,
    ffi::OsString,
    fs::{self, File},
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use mcap::{Compression, McapError, WriteOptions, Writer, records::MessageHeader, write::NoSeek};

use super::{RecordError, put_in_place};
use crate::{Channel, Drops, Encoder, Entry, Meta};

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
    /// The last flush; `None` if none is made by the clock.
    flushed: Option<Instant>,
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
        let container = Container::create(path, part_path(path))?;
        let mut recorder = Self::begin(container, meta)?;
        recorder.flushed = Some(Instant::now());
        recorder.flush()?;
        Ok(recorder)
    }

    /// Starts a record in memory: see [`Recorder::into_bytes`]. The same entries give the bytes of a
    /// file without timed flushes.
    ///
    /// # Errors
    ///
    /// When the metadata can't be encoded.
    pub fn in_memory(meta: &Meta) -> Result<Self, RecordError> {
        let mut recorder = Self::begin(Container::in_memory()?, meta)?;
        recorder.flush()?;
        Ok(recorder)
    }

    fn begin(mut container: Container, meta: &Meta) -> Result<Self, RecordError> {
        container.write(|writer| {
            writer.write_metadata(&meta.to_metadata())?;
            writer.attach(&meta.to_attachment())
        })?;
        let channels = container
            .describe()?
            .map(|id| WrittenChannel { id, sequence: 0 });
        Ok(Self {
            container,
            encoder: Encoder::new(meta.start),
            channels,
            flushed: None,
            unflushed: false,
            chunk_length: 0,
            entries: 0,
        })
    }

    /// Turns the flushes by the clock off, so that the same entries give the same bytes.
    /// For entries that can be recorded again, such as those of a simulation.
    #[must_use]
    pub const fn without_timed_flushes(mut self) -> Self {
        self.flushed = None;
        self
    }

    /// Where the finished record will be.
    pub fn path(&self) -> &Path {
        &self.container.path
    }

    /// Adds an entry, and flushes if the last flush is half a second old.
    ///
    /// # Errors
    ///
    /// When the file can't be written; later calls fail as well.
    pub fn write(&mut self, entry: &Entry) -> Result<(), RecordError> {
        let publications = self.encoder.encode(entry).map_err(|why| {
            RecordError::Invalid(format!("{why} for {}", self.container.part.display()))
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
        let is_due = |flushed: Instant| flushed.elapsed() >= FLUSH_PERIOD;
        if self.unflushed && self.flushed.is_some_and(is_due) {
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
        if let Some(flushed) = &mut self.flushed {
            *flushed = Instant::now();
        }
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
        let path = self.container.path.to_owned();
        let bytes = self.container.finish()?;
        Ok(Finished {
            path,
            entries: self.entries,
            bytes,
        })
    }

    /// Completes a record in memory, and returns it; nothing of a record in a file.
    ///
    /// # Errors
    ///
    /// When it can't be completed.
    pub fn into_bytes(self) -> Result<Vec<u8>, RecordError> {
        self.container.into_bytes()
    }
}

/// The profile in the header of the file: readers then expect ROS 2 messages.
pub(crate) const PROFILE: &str = "ros2";
/// The first word of the library in the header of our files.
pub(crate) const LIBRARY_NAME: &str = "singletrack";
/// The library in the header of the files that this version writes.
pub(crate) const LIBRARY: &str = concat!("singletrack ", env!("CARGO_PKG_VERSION"));

/// The name of the file at `path` until it is finished.
pub fn part_path(path: &Path) -> PathBuf {
    with_suffix(path, ".part")
}

/// A path with a suffix after its name.
pub(crate) fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    PathBuf::from(name)
}

/// A file that is being written, or its bytes in memory.
pub(crate) struct Container {
    /// Where the finished file will be.
    pub(crate) path: PathBuf,
    /// The unfinished file.
    pub(crate) part: PathBuf,
    writer: Writer<NoSeek<Output>>,
    /// Another handle of the same file, to sync it; none in memory.
    file: Option<File>,
}

/// Where the bytes go.
pub(crate) enum Output {
    File(BufWriter<File>),
    Memory(Vec<u8>),
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.write(bytes),
            Self::Memory(memory) => memory.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::File(file) => file.flush(),
            Self::Memory(memory) => memory.flush(),
        }
    }
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
        let output = Output::File(BufWriter::new(file));
        Self::with_output(path.to_owned(), part, output, Some(handle))
    }

    /// Starts one in memory.
    pub(crate) fn in_memory() -> Result<Self, RecordError> {
        let memory = Output::Memory(Vec::new());
        Self::with_output("memory".into(), "memory".into(), memory, None)
    }

    fn with_output(
        path: PathBuf,
        part: PathBuf,
        output: Output,
        file: Option<File>,
    ) -> Result<Self, RecordError> {
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
            .create(NoSeek::new(output))
            .map_err(|source| RecordError::Write {
                path: part.clone(),
                source: Box::new(source),
            })?;
        Ok(Self {
            path,
            part,
            writer,
            file,
        })
    }

    /// Calls `write` with the writer of the file.
    pub(crate) fn write<T>(
        &mut self,
        write: impl FnOnce(&mut Writer<NoSeek<Output>>) -> Result<T, McapError>,
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
    fn flush(&mut self) -> Result<(), RecordError> {
        self.end_chunk()?;
        let Some(file) = &self.file else {
            return Ok(());
        };
        file.sync_data().map_err(failure("sync", &self.part))?;
        // A system writes to a removed file without an error, and throws it away at the end.
        match fs::exists(&self.part) {
            Ok(false) => Err(RecordError::Gone(self.part.clone())),
            _ => Ok(()),
        }
    }

    /// Completes the file and renames it to its final name; returns its size.
    pub(crate) fn finish(mut self) -> Result<u64, RecordError> {
        self.write(Writer::finish)?;
        let mut output = self.writer.into_inner().into_inner();
        let part = &self.part;
        output.flush().map_err(failure("write", part))?;
        let Some(file) = self.file else {
            return Ok(0);
        };
        file.sync_all().map_err(failure("sync", part))?;
        let bytes = file.metadata().map_err(failure("look at", part))?.len();
        if self.path.exists() {
            return Err(RecordError::Exists(self.path));
        }
        put_in_place(part, &self.path).map_err(failure("rename", part))?;
        Ok(bytes)
    }

    /// Completes what is in memory, and returns it.
    fn into_bytes(mut self) -> Result<Vec<u8>, RecordError> {
        self.write(Writer::finish)?;
        match self.writer.into_inner().into_inner() {
            Output::Memory(memory) => Ok(memory),
            Output::File(_) => Ok(Vec::new()),
        }
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

/// How long the thread sleeps when there is nothing to write.
const IDLE: Duration = Duration::from_millis(5);

/// The input of a ring of entries. It neither waits nor allocates.
pub struct FeedInput {
    ring: rtrb::Producer<Entry>,
    dropped: Arc<AtomicU64>,
}

/// The output of a ring of entries.
pub struct FeedOutput {
    ring: rtrb::Consumer<Entry>,
    dropped: Arc<AtomicU64>,
}

/// A ring for `capacity` entries of about 5 kB each. Each producing thread needs its own.
pub fn feed(capacity: usize) -> (FeedInput, FeedOutput) {
    let (producer, consumer) = rtrb::RingBuffer::new(capacity);
    let dropped = Arc::new(AtomicU64::new(0));
    (
        FeedInput {
            ring: producer,
            dropped: Arc::clone(&dropped),
        },
        FeedOutput {
            ring: consumer,
            dropped,
        },
    )
}

impl FeedInput {
    /// Pushes an entry; false if the ring is full. Such losses are counted and recorded.
    pub fn push(&mut self, entry: Entry) -> bool {
        let pushed = self.ring.push(entry).is_ok();
        if !pushed {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        pushed
    }
}

impl FeedOutput {
    /// The oldest entry in the ring; none if the ring is empty.
    pub fn pop(&mut self) -> Option<Entry> {
        self.ring.pop().ok()
    }
}

/// A [`Recorder`] on a thread of its own.
pub struct RecorderThread {
    path: PathBuf,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<Finished, RecordError>>,
}

impl RecorderThread {
    /// Starts to write the entries of `feed`. Before the thread writes an entry, it
    /// passes it to `observe`, which must be short: the ring fills meanwhile.
    ///
    /// # Errors
    ///
    /// When the thread can't be started.
    pub fn start(
        recorder: Recorder,
        feed: FeedOutput,
        observe: impl FnMut(&Entry) + Send + 'static,
    ) -> Result<Self, RecordError> {
        let path = recorder.path().to_owned();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || run(recorder, feed, observe, &stopped))
            .map_err(|error| RecordError::Thread {
                path: path.clone(),
                what: format!("can't be started: {error}"),
            })?;
        Ok(Self { path, stop, thread })
    }

    /// Whether the thread still writes. It stops early when the file can't be written:
    /// [`RecorderThread::finish`] then gives the error.
    pub fn is_writing(&self) -> bool {
        !self.thread.is_finished()
    }

    /// Writes the entries that are still in the ring and completes the file.
    ///
    /// # Errors
    ///
    /// When the file could not be written, now or earlier.
    pub fn finish(self) -> Result<Finished, RecordError> {
        self.stop.store(true, Ordering::Release);
        self.thread.join().unwrap_or_else(|_| {
            Err(RecordError::Thread {
                path: self.path,
                what: "has panicked".to_owned(),
            })
        })
    }
}

fn run(
    mut recorder: Recorder,
    mut feed: FeedOutput,
    mut observe: impl FnMut(&Entry),
    stop: &AtomicBool,
) -> Result<Finished, RecordError> {
    let mut drops = Drops {
        time_ns: 0,
        entries: 0,
    };
    loop {
        // Read before the ring is emptied, so that every entry pushed before the stop is
        // written.
        let stopping = stop.load(Ordering::Acquire);
        let mut idle = true;
        // At most as many as the ring held: drops are noted even if it never gets empty.
        for _ in 0..feed.ring.slots() {
            let Some(entry) = feed.pop() else { break };
            idle = false;
            drops.time_ns = drops.time_ns.max(entry.time_ns());
            observe(&entry);
            recorder.write(&entry)?;
        }
        let dropped = feed.dropped.load(Ordering::Relaxed);
        if dropped != drops.entries {
            drops.entries = dropped;
            let entry = Entry::Drops(drops);
            observe(&entry);
            recorder.write(&entry)?;
        }
        if stopping {
            return recorder.finish();
        }
        if idle {
            recorder.flush_if_due()?;
            thread::sleep(IDLE);
        }
    }
}
