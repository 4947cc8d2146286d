//! The progress of a drive, by the status.

use std::time::Duration;

use singletrack_api::{Code, Refused};
use singletrack_pilot::{Mode, Reason};
use tokio::time::Instant;

use super::outcome::{arm_outcome, cannot_arm};
use crate::{clock::monotonic_ns, snapshot::Snapshot};

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
                    "can't arm: the control thread does not answer",
                ));
            }
            None => {}
        }
        Progress::Underway
    }
}
