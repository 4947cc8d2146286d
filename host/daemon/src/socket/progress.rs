//! The progress of a drive by the status: whether a request to arm is obeyed, and why not.

use std::time::Duration;

use singletrack_api::{Code, Refused};
use singletrack_core::reasons::Why;
use singletrack_pilot::{Mode, Reason};
use tokio::time::Instant;

use crate::{clock::monotonic_ns, snapshot::Snapshot};

/// Whether a request to arm is obeyed, by a tick; `None` while it is open.
pub(super) fn arm_outcome(asked_ns: u64, tick_start_ns: u64, mode: Mode) -> Option<bool> {
    // A tick that began before the request may not have seen it.
    if tick_start_ns <= asked_ns {
        return None;
    }
    match mode {
        Mode::Driving | Mode::Jogging => Some(true),
        Mode::Arming => None,
        // The attempt has ended, even if no poll saw it in progress.
        _ => Some(false),
    }
}

/// Why a pilot that is not ready can't be armed: the reason of now, and not the one for which
/// the last drive ended.
pub(super) fn not_ready(snapshot: &Snapshot) -> Refused {
    let now = snapshot.output().and_then(|output| output.preflight);
    cannot_arm(snapshot, now.or(snapshot.reason()))
}

/// Why the car can't be armed, and what to do, in the words of `singletrack status`.
pub(super) fn cannot_arm(snapshot: &Snapshot, reason: Option<Reason>) -> Refused {
    let mode = snapshot.mode();
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

/// Interval at which the status is checked for the outcome of an arm request and for the end of a
/// drive.
pub(super) const POLL: Duration = Duration::from_millis(5);

/// The longest wait for the outcome of an arm request: the supervisor's time-out, and the time
/// in which a board switches on the ESC's supply.
const ARM_TIMEOUT: Duration = Duration::from_secs(12);

/// The progress of an attended drive.
pub(super) enum Progress {
    /// It is still being armed, or drives.
    Underway,
    /// It did not begin.
    Refused(Refused),
    /// It has ended, and the car stands or is out of control.
    Ended(Mode, Option<Reason>),
}

/// Watches one drive by the status.
pub(super) struct DriveWatch {
    asked_ns: u64,
    asked: Instant,
    pub(super) has_driven: bool,
}

impl DriveWatch {
    pub(super) fn new() -> Self {
        Self {
            asked_ns: monotonic_ns(),
            asked: Instant::now(),
            has_driven: false,
        }
    }

    pub(super) fn progress(&mut self, snapshot: &Snapshot) -> Progress {
        let Some(tick) = &snapshot.tick else {
            return Progress::Underway;
        };
        let (mode, reason) = (tick.output.mode, tick.output.reason);
        if self.has_driven {
            return match mode {
                Mode::Idle | Mode::Ready | Mode::Disconnected | Mode::Fault => {
                    Progress::Ended(mode, reason)
                }
                _ => Progress::Underway,
            };
        }
        match arm_outcome(self.asked_ns, tick.start_ns, mode) {
            Some(true) => self.has_driven = true,
            Some(false) => return Progress::Refused(cannot_arm(snapshot, reason)),
            None if self.asked.elapsed() > ARM_TIMEOUT => {
                return Progress::Refused(Refused::new(
                    Code::Stalled,
                    "can't arm: neither armed nor refused within 12 s; does the control thread run (see the \
                     log), and does the board answer?",
                ));
            }
            None => {}
        }
        Progress::Underway
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
