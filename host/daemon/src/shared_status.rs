//! The state that the collector publishes to the other threads.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use singletrack_api::{Calibration, Cameras, State};
use singletrack_pilot::Learned;
use singletrack_protocol::{BoardMode, Status, StopCause};
use singletrack_record::{ClockMapping, TickRecord, Topic};
use tokio::sync::{Semaphore, broadcast};

use crate::{messages::MessageFeed, summary::Tally};

/// Lines that a watcher may be behind before it misses some.
const WATCH_CAPACITY: usize = 1_024;

/// States that wait for a slow reader: 160 ms at 100 Hz. A controller has no use for an older state;
/// who wants every tick watches `tick`.
const STATE_CAPACITY: usize = 16;

/// Ticks that a client that waits for one may be behind: those of 10 s.
const TICK_CAPACITY: usize = 1_024;

/// The largest number of control clients that watch at a time. It is less than their largest number:
/// however many viewers watch, others may command.
pub(crate) const WATCHERS: usize = 24;

/// The latest value of everything that the threads report.
#[derive(Clone, Debug, Default)]
pub struct Latest {
    /// The last tick, without its events; `None` before the first.
    pub tick: Option<Arc<TickRecord<0>>>,
    /// The view of it that the control socket gives.
    pub state: Option<State>,
    /// The board's own mode and the cause of its last stop, from its last telemetry.
    pub board: Option<(BoardMode, StopCause)>,
    /// The last status message of the board.
    pub board_status: Option<Status>,
    /// Whether the configuration in force is proved on this car; `None` before the board has
    /// given its number.
    pub proved: Option<bool>,
    /// What drives say of the configuration of this number.
    pub calibration: Option<(u32, Calibration)>,
    /// What the pilot corrects in this drive, if it learns.
    pub learned: Option<Learned>,
    /// What is wrong with the cameras, or that nothing is.
    pub cameras: Cameras,
    /// Why the serial port can't be opened; none if it is open.
    pub serial_error: Option<String>,
    /// Why the record ended before the daemon, such as a full disk.
    pub record_error: Option<String>,
    /// Why the record will soon end, such as a disk that is nearly full.
    pub record_warning: Option<String>,
}

/// The latest values, and the stream of entries for watchers.
#[derive(Debug)]
pub(crate) struct SharedStatus {
    latest: Mutex<Latest>,
    tally: Mutex<Tally>,
    /// Every entry of the record as a line of JSON.
    pub(crate) watchers: broadcast::Sender<(Topic, Arc<str>)>,
    /// Entries as the messages of the record.
    pub(crate) messages: MessageFeed,
    /// The state of every tick as a line of JSON, with its end.
    pub(crate) states: broadcast::Sender<Arc<str>>,
    /// Every tick, for those who wait for one: none is skipped, so that a drive that begins and
    /// ends between two looks is seen.
    pub(crate) ticks: broadcast::Sender<Arc<TickRecord<0>>>,
    /// For each client that watches, one of [`WATCHERS`].
    pub(crate) watch_places: Semaphore,
}

impl SharedStatus {
    pub(crate) fn new(clocks: ClockMapping) -> Self {
        Self {
            latest: Mutex::default(),
            tally: Mutex::default(),
            watchers: broadcast::Sender::new(WATCH_CAPACITY),
            messages: MessageFeed::new(clocks),
            states: broadcast::Sender::new(STATE_CAPACITY),
            ticks: broadcast::Sender::new(TICK_CAPACITY),
            watch_places: Semaphore::new(WATCHERS),
        }
    }

    /// Locks the latest values. The control thread must not call this: it would wait for
    /// threads of lower priority.
    pub(crate) fn latest(&self) -> MutexGuard<'_, Latest> {
        // The values hold no invariant that a panic could break.
        self.latest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Locks the figures; not for the control thread either.
    pub(crate) fn tally(&self) -> MutexGuard<'_, Tally> {
        self.tally.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes a tick the latest one, with what else has changed, and then sends it: a client that has
    /// read in its state that the car is ready, and arms, is judged by nothing older.
    pub(crate) fn publish(
        &self,
        tick: TickRecord<0>,
        state: State,
        change: impl FnOnce(&mut Latest),
    ) {
        let is_read = self.states.receiver_count() > 0;
        let line = is_read
            .then(|| serde_json::to_string(&state).ok())
            .flatten();
        let tick = Arc::new(tick);
        {
            let mut latest = self.latest();
            change(&mut latest);
            latest.tick = Some(Arc::clone(&tick));
            latest.state = Some(state);
        }
        // An error means that nobody reads.
        if let Some(line) = line {
            let _ = self.states.send(Arc::from(line + "\n"));
        }
        let _ = self.ticks.send(tick);
    }
}

#[cfg(test)]
mod tests {
    use std::{
        pin::pin,
        sync::OnceLock,
        task::{Context, Poll, Wake},
    };

    use singletrack_control::Time;
    use singletrack_core::state_stream::States;
    use singletrack_pilot::{Mode, Output};
    use singletrack_record::LinkPhase;

    use super::*;

    impl SharedStatus {
        /// Publishes a tick after which the pilot has this mode.
        pub(crate) fn tick(&self, start_ns: u64, mode: Mode, change: impl FnOnce(&mut Latest)) {
            let tick = TickRecord {
                index: 0,
                scheduled_ns: 0,
                start_ns,
                finish_ns: 0,
                skipped: 0,
                pilot_time: Time(0),
                events: Default::default(),
                events_dropped: 0,
                output: Output::neutral(mode),
                drive: None,
                link: LinkPhase::Ready,
            };
            let state = States::default().state(&tick);
            self.publish(tick, state, change);
        }
    }

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
        client.status.tick(0, Mode::Idle, change);
        assert_eq!(client.found.get(), Some(&Some(true)));
        assert!(matches!(reads.poll(&mut context), Poll::Ready(Ok(line)) if line.ends_with("}\n")));
    }
}
