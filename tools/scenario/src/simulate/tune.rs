//! When the operator of a scenario tunes the pilot.

use singletrack_control::Velocity;
use singletrack_core::config::TuningRule;
use singletrack_pilot::Tuning;
use singletrack_settings::{check, section};

use super::{MOMENT, error::ScenarioError};

section! {
    /// A request to tune the pilot, as by `singletrack tune`, any number of times; `[tuning]` must
    /// allow it.
    "tune" => pub TuneSection: Copy;
    [];

    /// When.
    at_s: f64;
    /// Gains along x and y.
    gain_per_s: Option<[f64; 2]> = None;
    /// The distance p.
    point_distance_m: Option<f64> = None;
}

impl TuneSection {
    /// The values.
    #[must_use]
    pub fn tuning(&self) -> Tuning {
        Tuning {
            gain: self.gain_per_s.map(|[x, y]| Velocity::new(x, y)),
            point_distance: self.point_distance_m,
        }
    }

    /// Refuses a time that does not exist, and values that the daemon would refuse.
    pub(super) fn validate(&self, rule: &TuningRule) -> Result<(), ScenarioError> {
        let at_s = self.at_s;
        check("tune.at_s", &at_s, &MOMENT)?;
        rule.check(&self.tuning(), None)
            .map_err(|source| ScenarioError::Tune { at_s, source })
    }
}
