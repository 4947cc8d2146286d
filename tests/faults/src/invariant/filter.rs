//! What the safety filter promises.

use singletrack_control::Position;
use singletrack_pilot::Mode;

use super::{Invariant, Verdict};
use crate::observation::Observation;

/// `filter`: with the safety filter on, the true centre of mass never leaves the geofence,
/// whatever the outer loop wants. Nothing is allowed beyond it: no silence of the host, no bend,
/// no error of the estimate.
///
/// The claim rests on assumptions: a car that is calibrated, brakes as configured and is not
/// pushed; cameras, line, board and host without a fault, which `fence` judges with its
/// allowance. Hostile, silent and mistaken programs break none of them. A car that was armed
/// outside is not judged until it is inside.
pub(super) struct Filter {
    excused: bool,
    /// Whether a fault has broken an assumption.
    broken: bool,
}

impl Default for Filter {
    /// The car may have been put down outside.
    fn default() -> Self {
        Self {
            excused: true,
            broken: false,
        }
    }
}

impl Invariant for Filter {
    fn name(&self) -> &'static str {
        "filter"
    }

    fn check(&mut self, observation: &Observation<'_>) -> Verdict {
        let Observation {
            spec,
            truth,
            faults,
            new_faults,
            ..
        } = observation;
        let mut faults = faults.iter().chain(*new_faults);
        self.broken |= faults.any(|fault| !fault.kind.changes_setpoints());
        if !spec.situation.safety_filter || !spec.is_tolerable || self.broken {
            return Ok(());
        }
        let clearance = spec.fence.clearance(&Position::new(truth.x, truth.y));
        let mode = observation.tick.map(|tick| tick.output.mode);
        if mode == Some(Mode::Arming) {
            self.excused = clearance < 0.0;
        }
        // No geofence holds an operator who jogs.
        self.excused |= observation.jogs;
        self.excused &= clearance < 0.0;
        if clearance >= 0.0 || self.excused {
            return Ok(());
        }
        Err(format!(
            "{:.3} m beyond the geofence at {:.2} m/s with the safety filter on",
            -clearance, truth.speed
        ))
    }
}
