//! The state that the collector publishes to the other threads.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use singletrack_core::diagnosis::Diagnosis;
use singletrack_protocol::{BoardMode, Status, StopCause};
use singletrack_record::Topic;
use tokio::sync::broadcast;

use crate::{
    snapshot::TickView, socket::SetpointCounters, state_stream::STATE_LINES, summary::Tally,
};

/// Lines that a watcher may be behind before it misses some.
const WATCH_CAPACITY: usize = 1_024;

/// The latest value of everything that the threads report.
#[derive(Debug, Default)]
pub(crate) struct Latest {
    pub(crate) tick: Option<TickView>,
    pub(crate) board: Option<(BoardMode, StopCause)>,
    pub(crate) board_status: Option<Status>,
    /// Whether the configuration in force is proved on this car; `None` before the board has
    /// given its number.
    pub(crate) proved: Option<bool>,
    /// What is wrong with the cameras.
    pub(crate) cameras: Diagnosis,
    pub(crate) tally: Tally,
    /// Why the record ended before the daemon.
    pub(crate) record_error: Option<String>,
}

/// The latest values, and the stream of entries for watchers.
#[derive(Debug)]
pub(crate) struct SharedStatus {
    latest: Mutex<Latest>,
    /// Every entry of the record as a line of JSON.
    pub(crate) watchers: broadcast::Sender<(Topic, Arc<str>)>,
    /// The state of every tick as a line of JSON, with its end.
    pub(crate) states: broadcast::Sender<Arc<str>>,
    /// The set-points of all clients.
    pub(crate) setpoints: SetpointCounters,
}

impl SharedStatus {
    pub(crate) fn new() -> Self {
        Self {
            latest: Mutex::default(),
            watchers: broadcast::Sender::new(WATCH_CAPACITY),
            states: broadcast::Sender::new(STATE_LINES),
            setpoints: SetpointCounters::default(),
        }
    }

    /// Locks the latest values. The control thread must not call this: it would wait for
    /// threads of lower priority.
    pub(crate) fn latest(&self) -> MutexGuard<'_, Latest> {
        // The values hold no invariant that a panic could break.
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
