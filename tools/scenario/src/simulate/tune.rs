//! When the operator of a scenario tunes the pilot.

use serde::Deserialize;
use singletrack_control::Velocity;
use singletrack_core::config::TuningRule;
use singletrack_pilot::Tuning;
use singletrack_settings::check;

use super::{error::ScenarioError, operator::MOMENT};

/// A request to tune the pilot, as `singletrack tune`; `[tuning]` must allow it.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TuneSection {
    /// When, in s of the trajectory.
    pub at_s: f64,
    /// Gains along x and y, per second.
    pub gain_per_s: Option<[f64; 2]>,
    /// The distance p, in m.
    pub point_distance_m: Option<f64>,
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
