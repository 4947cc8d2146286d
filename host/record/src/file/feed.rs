//! Writing a record on a thread of its own, behind bounded rings: producers never wait,
//! and entries that find a ring full are counted.

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use super::{Finished, RecordError, Recorder};
use crate::{Drops, Entry};

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
