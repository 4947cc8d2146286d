//! Writing a record without keeping anyone waiting: bounded rings in, a thread
//! that empties them, and a count of what found no room.

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use crate::{Drops, Entry, Finished, RecordError, Recorder};

/// How long the thread sleeps when there is nothing to write.
const IDLE: Duration = Duration::from_millis(5);

/// The end of a ring where entries go in. Neither waits nor allocates.
pub struct FeedInput {
    ring: rtrb::Producer<Entry>,
    dropped: Arc<AtomicU64>,
}

/// The end of a ring where entries come out.
pub struct FeedOutput {
    ring: rtrb::Consumer<Entry>,
    dropped: Arc<AtomicU64>,
}

/// A ring for `capacity` entries, about 5 kB each. One thread, one ring.
#[must_use]
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
    /// Hands an entry over; false if the ring is full, which is counted and
    /// recorded.
    pub fn push(&mut self, entry: Entry) -> bool {
        let pushed = self.ring.push(entry).is_ok();
        if !pushed {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        pushed
    }
}

impl FeedOutput {
    /// The oldest entry that waits; none if none does.
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
    /// Starts writing what comes out of `feeds`. Before it writes an entry, it
    /// shows it to `observe`, which should not take long: meanwhile the rings fill.
    ///
    /// # Errors
    ///
    /// When the thread cannot be started.
    pub fn start(
        recorder: Recorder,
        feeds: Vec<FeedOutput>,
        observe: impl FnMut(&Entry) + Send + 'static,
    ) -> Result<Self, RecordError> {
        let path = recorder.path().to_owned();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || run(recorder, feeds, observe, &stopped))
            .map_err(|error| RecordError::Thread {
                path: path.clone(),
                what: format!("cannot be started: {error}"),
            })?;
        Ok(Self { path, stop, thread })
    }

    /// Whether it still writes. It stops when it is told to, or when the file
    /// cannot be written: [`RecorderThread::finish`] then says why.
    #[must_use]
    pub fn is_writing(&self) -> bool {
        !self.thread.is_finished()
    }

    /// Writes what is still in the rings and completes the file.
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
    mut feeds: Vec<FeedOutput>,
    mut observe: impl FnMut(&Entry),
    stop: &AtomicBool,
) -> Result<Finished, RecordError> {
    let mut drops = Drops {
        time_ns: 0,
        entries: 0,
    };
    loop {
        // Asked before the rings are emptied: what was pushed before the stop is written.
        let stopping = stop.load(Ordering::Acquire);
        let mut idle = true;
        for feed in &mut feeds {
            // No more than was there: a fast feed must not starve the others.
            for _ in 0..feed.ring.slots() {
                let Ok(entry) = feed.ring.pop() else { break };
                idle = false;
                drops.time_ns = drops.time_ns.max(entry.time_ns());
                observe(&entry);
                recorder.write(&entry)?;
            }
        }
        let dropped = feeds
            .iter()
            .map(|feed| feed.dropped.load(Ordering::Relaxed))
            .sum();
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
