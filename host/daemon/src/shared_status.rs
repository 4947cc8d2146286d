//! The state that the collector publishes to the other threads.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use singletrack_api::{Calibration, State};
use singletrack_core::diagnosis::Diagnosis;
use singletrack_pilot::Learned;
use singletrack_protocol::{BoardMode, Status, StopCause};
use singletrack_record::{ClockMapping, TickRecord, Topic};
use tokio::sync::{Semaphore, broadcast};

use crate::{messages::MessageFeed, socket::SetpointCounters, summary::Tally};

/// Lines that a watcher may be behind before it misses some.
const WATCH_CAPACITY: usize = 1_024;

/// The same of the states: 160 ms at 100 Hz. A controller has no use for an older state; who wants
/// every tick watches `tick`.
const STATE_CAPACITY: usize = 16;

/// The largest number of control clients that watch at a time. It is less than their largest number:
/// however many viewers watch, others may command.
pub(crate) const WATCHERS: usize = 24;

/// The latest value of everything that the threads report.
#[derive(Debug, Default)]
pub(crate) struct Latest {
    pub(crate) tick: Option<Arc<TickRecord<0>>>,
    pub(crate) state: Option<State>,
    pub(crate) board: Option<(BoardMode, StopCause)>,
    pub(crate) board_status: Option<Status>,
    /// Whether the configuration in force is proved on this car; `None` before the board has
    /// given its number.
    pub(crate) proved: Option<bool>,
    /// What drives say of the configuration of this number.
    pub(crate) calibration: Option<(u32, Calibration)>,
    /// What the pilot corrects in this drive, if it learns.
    pub(crate) learned: Option<Learned>,
    /// What is wrong with the cameras.
    pub(crate) cameras: Diagnosis,
    pub(crate) tally: Tally,
    /// Why the record ended before the daemon.
    pub(crate) record_error: Option<String>,
    /// Why the record will soon end.
    pub(crate) record_warning: Option<String>,
}

/// The latest values, and the stream of entries for watchers.
#[derive(Debug)]
pub(crate) struct SharedStatus {
    latest: Mutex<Latest>,
    /// Every entry of the record as a line of JSON.
    pub(crate) watchers: broadcast::Sender<(Topic, Arc<str>)>,
    /// The same as the messages of the record.
    pub(crate) messages: MessageFeed,
    /// The state of every tick as a line of JSON, with its end.
    pub(crate) states: broadcast::Sender<Arc<str>>,
    /// For each client that watches, one of [`WATCHERS`].
    pub(crate) watch_places: Semaphore,
    /// The set-points of all clients.
    pub(crate) setpoints: SetpointCounters,
}

impl SharedStatus {
    pub(crate) fn new(clocks: ClockMapping) -> Self {
        Self {
            latest: Mutex::default(),
            watchers: broadcast::Sender::new(WATCH_CAPACITY),
            messages: MessageFeed::new(clocks),
            states: broadcast::Sender::new(STATE_CAPACITY),
            watch_places: Semaphore::new(WATCHERS),
            setpoints: SetpointCounters::default(),
        }
    }

    /// Locks the latest values. The control thread must not call this: it would wait for
    /// threads of lower priority.
    pub(crate) fn latest(&self) -> MutexGuard<'_, Latest> {
        // The values hold no invariant that a panic could break.
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the latest values, and then sends the state line of the tick: a client that has
    /// read in it that the car is ready, and arms, is judged by nothing older.
    pub(crate) fn publish(&self, line: Option<String>, change: impl FnOnce(&mut Latest)) {
        change(&mut self.latest());
        if let Some(line) = line {
            // An error means that the last reader has left.
            let _ = self.states.send(Arc::from(line + "\n"));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{
        pin::pin,
        sync::OnceLock,
        task::{Context, Poll, Wake},
    };

    use super::*;

    /// A client at the moment at which a line wakes it.
    struct Client {
        status: SharedStatus,
        /// What it finds then.
        found: OnceLock<Option<bool>>,
    }

    impl Wake for Client {
        fn wake(self: Arc<Self>) {
            let _ = self.found.set(self.status.latest().proved);
        }
    }

    #[test]
    fn who_is_woken_by_the_line_of_a_tick_finds_its_values() {
        let client = Arc::new(Client {
            status: SharedStatus::new(ClockMapping {
                wall_ns: 0,
                monotonic_ns: 0,
            }),
            found: OnceLock::new(),
        });
        let mut lines = client.status.states.subscribe();
        let waker = Arc::clone(&client).into();
        let mut reads = pin!(lines.recv());
        let mut context = Context::from_waker(&waker);
        assert!(reads.as_mut().poll(&mut context).is_pending());
        let change = |latest: &mut Latest| latest.proved = Some(true);
        client.status.publish(Some("line".to_owned()), change);
        assert_eq!(client.found.get(), Some(&Some(true)));
        assert_eq!(reads.poll(&mut context), Poll::Ready(Ok("line\n".into())));
    }
}
