//! Whether a request to arm is obeyed, and why not.

use singletrack_api::{Code, Refused};
use singletrack_core::reasons::Why;
use singletrack_pilot::{Mode, Reason};

use crate::snapshot::Snapshot;

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
