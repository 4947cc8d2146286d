//! The progress of a drive by its ticks: whether a request to arm is obeyed, and why not.

use std::{future::pending, sync::Arc, time::Duration};

use singletrack_api::{Code, Refused};
use singletrack_core::reasons::Why;
use singletrack_pilot::{Mode, Reason};
use singletrack_record::TickRecord;
use tokio::{
    sync::broadcast::{Receiver, error::RecvError},
    time::{Instant, timeout_at},
};

use crate::{
    clock::monotonic_ns,
    handle::{DaemonHandle, Snapshot},
};

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
pub(super) fn arm_outcome(asked_ns: u64, tick_start_ns: u64, mode: Mode) -> Option<bool> {
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
