//! The order of the drives: which request to arm is the latest, and what may end it; and the progress of
//! a drive by its ticks: whether a request to arm is obeyed, and why not.

use std::{
    future::pending,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use singletrack_api::{Code, Refused};
use singletrack_core::{ControlRequest, reasons::Why};
use singletrack_pilot::{Mode, PilotRequest, Reason};
use singletrack_record::TickRecord;
use tokio::{
    sync::{
        Mutex,
        broadcast::{Receiver, error::RecvError},
    },
    time::{Instant, timeout_at},
};

use crate::{
    clock::monotonic_ns,
    handle::{DaemonHandle, Snapshot},
};

/// Numbers the drives, so that a client or task of an earlier one does not end a later one, and
/// orders the requests to arm.
#[derive(Clone, Debug, Default)]
pub(crate) struct Drives(Arc<Orders>);

#[derive(Debug, Default)]
struct Orders {
    /// The number of the latest drive.
    number: AtomicU64,
    /// When it was asked for.
    asked_ns: AtomicU64,
    /// Counts the requests to disarm and to stop.
    stops: AtomicU64,
    /// Held while a request to arm is judged: one at a time.
    judging: Arc<Mutex<()>>,
}

/// The right to renew and to end one drive.
#[derive(Clone, Debug)]
pub(super) struct Ticket {
    drives: Drives,
    number: u64,
}

impl Drives {
    pub(super) fn next(&self) -> Ticket {
        self.0.asked_ns.store(monotonic_ns(), Ordering::Release);
        Ticket {
            drives: self.clone(),
            number: self.0.number.fetch_add(1, Ordering::AcqRel) + 1,
        }
    }

    /// A client asks for a disarm or a stop: a request to arm that is being judged is void.
    pub(super) fn stop(&self) {
        self.0.stops.fetch_add(1, Ordering::AcqRel);
    }

    pub(super) fn stops(&self) -> u64 {
        self.0.stops.load(Ordering::Acquire)
    }

    /// The lock of a request to arm that is being judged.
    pub(super) fn judging(&self) -> Arc<Mutex<()>> {
        Arc::clone(&self.0.judging)
    }

    /// Whether the last request to arm may not have reached the pilot at this tick.
    pub(super) fn is_open(&self, snapshot: &Snapshot) -> bool {
        let asked_ns = self.0.asked_ns.load(Ordering::Acquire);
        let tick = snapshot.latest.tick.as_ref();
        tick.is_none_or(|tick| tick.start_ns <= asked_ns)
    }
}

impl Ticket {
    pub(super) fn is_latest(&self) -> bool {
        self.drives.0.number.load(Ordering::Acquire) == self.number
    }

    /// Passes a request on if the drive is still the latest one.
    pub(super) fn push(&self, daemon: &DaemonHandle, request: PilotRequest) -> Result<(), Refused> {
        self.pass(daemon, ControlRequest::Pilot(request))
    }

    /// Passes any request on if the drive is still the latest one.
    pub(super) fn pass(
        &self,
        daemon: &DaemonHandle,
        request: ControlRequest,
    ) -> Result<(), Refused> {
        if !self.is_latest() {
            return Ok(());
        }
        let pushed = daemon.requests.push(request);
        pushed.map_err(|error| Refused::new(Code::Stalled, error))
    }
}

/// A tick, which all who wait for it share.
type Tick = Arc<TickRecord<0>>;

/// Waits for the next tick.
pub(super) async fn next_tick(ticks: &mut Receiver<Tick>) -> Tick {
    loop {
        match ticks.recv().await {
            Ok(tick) => return tick,
            // This task was not run for seconds: the oldest ticks are lost, and the drive with them.
            Err(RecvError::Lagged(_)) => {}
            Err(RecvError::Closed) => pending().await,
        }
    }
}

/// Whether a request to arm is obeyed, by a tick; `None` while it is open.
fn arm_outcome(asked_ns: u64, tick_start_ns: u64, mode: Mode) -> Option<bool> {
    // A tick that began before the request may not have seen it.
    if tick_start_ns <= asked_ns {
        return None;
    }
    match mode {
        Mode::Driving | Mode::Jogging => Some(true),
        Mode::Arming => None,
        _ => Some(false),
    }
}

/// Why a pilot that is not ready can't be armed: the reason of now, and not the one for which
/// the last drive ended.
pub(super) fn not_ready(snapshot: &Snapshot) -> Refused {
    let now = snapshot.output().and_then(|output| output.preflight);
    cannot_arm(snapshot, snapshot.mode(), now.or(snapshot.reason()))
}

/// Why the car can't be armed, and what to do, in the words of `singletrack status`.
pub(super) fn cannot_arm(snapshot: &Snapshot, mode: Mode, reason: Option<Reason>) -> Refused {
    let text = match reason {
        Some(reason) => {
            let why = Why::explain(reason.name(), &snapshot.status());
            format!("can't arm: mode {mode}: {why}")
        }
        None if matches!(mode, Mode::Driving | Mode::Slowing | Mode::Jogging) => {
            format!("can't arm: the car is driven already (mode {mode}); first end that drive")
        }
        None => format!("can't arm: mode {mode}"),
    };
    Refused::new(Code::NotReady, text)
}

/// The longest wait for the outcome of an arm request: the supervisor's time-out, and the time
/// in which a board switches on the ESC's supply.
const ARM_TIMEOUT: Duration = Duration::from_secs(12);

/// The progress of a drive.
pub(super) enum Progress {
    /// It is still being armed.
    Arming,
    /// It is underway in this tick.
    Driving(Tick),
    /// It did not begin.
    Refused(Refused),
    /// It has ended, and the car stands or is out of control.
    Ended(Mode, Option<Reason>),
}

/// Watches one drive by its ticks.
pub(super) struct DriveWatch {
    ticks: Receiver<Tick>,
    asked_ns: u64,
    asked: Instant,
    has_driven: bool,
}

impl DriveWatch {
    /// Watches a drive that has just been asked for.
    pub(super) fn new(daemon: &DaemonHandle) -> Self {
        Self {
            ticks: daemon.status.ticks.subscribe(),
            asked_ns: monotonic_ns(),
            asked: Instant::now(),
            has_driven: false,
        }
    }

    /// Waits for the next tick, while the drive is armed no longer than [`ARM_TIMEOUT`].
    pub(super) async fn next(&mut self, daemon: &DaemonHandle) -> Progress {
        let next = next_tick(&mut self.ticks);
        if self.has_driven {
            let tick = next.await;
            return match tick.output.mode {
                mode @ (Mode::Idle | Mode::Ready | Mode::Disconnected | Mode::Fault) => {
                    Progress::Ended(mode, tick.output.reason)
                }
                _ => Progress::Driving(tick),
            };
        }
        let Ok(tick) = timeout_at(self.asked + ARM_TIMEOUT, next).await else {
            return Progress::Refused(Refused::new(
                Code::Stalled,
                "can't arm: neither armed nor refused within 12 s; does the control thread run (see the \
                 log), and does the board answer?",
            ));
        };
        let (mode, reason) = (tick.output.mode, tick.output.reason);
        match arm_outcome(self.asked_ns, tick.start_ns, mode) {
            None => Progress::Arming,
            Some(true) => {
                self.has_driven = true;
                Progress::Driving(tick)
            }
            Some(false) => Progress::Refused(cannot_arm(&daemon.snapshot(), mode, reason)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ticket_of_an_earlier_drive_is_void() {
        let drives = Drives::default();
        let (first, second) = (drives.next(), drives.next());
        assert!(!first.is_latest() && second.is_latest());
    }

    #[test]
    fn an_arm_is_answered_by_the_first_later_tick_that_is_not_arming() {
        let outcome = |start_ns, mode| arm_outcome(100, start_ns, mode);
        assert_eq!(outcome(100, Mode::Ready), None);
        assert_eq!(outcome(101, Mode::Arming), None);
        assert_eq!(outcome(101, Mode::Driving), Some(true));
        for mode in [Mode::Ready, Mode::Idle, Mode::Disconnected] {
            assert_eq!(outcome(101, mode), Some(false));
        }
    }
}
