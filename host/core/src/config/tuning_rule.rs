//! What a request to tune may ask for.

use singletrack_control::Velocity;
use singletrack_pilot::{Tuned, Tuning, TuningBounds};

use super::{
    Config, OuterLoopSection,
    tuning::{GOVERNED, no_gains},
};

/// The rule by which requests to tune are judged, from a configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TuningRule {
    /// What may be tuned; none if nothing may.
    pub bounds: Option<TuningBounds>,
    /// The gains of the configuration, per second; none for a loop without such gains.
    pub gain: Option<Velocity>,
    /// The p of the configuration, in m.
    pub point_distance: f64,
    kind: &'static str,
    governed: bool,
}

/// Why a request to tune is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TuningError {
    /// Nothing can be tuned.
    #[error(
        "nothing can be tuned: set tuning.enabled = true, with bounds, in the configuration of \
         the daemon"
    )]
    Disabled,
    /// There is no value.
    #[error("there is nothing to tune: give gain_per_s, point_distance_m or both")]
    Nothing,
    /// This value can't be tuned.
    #[error("{name} can't be tuned: {reason}")]
    Fixed {
        /// The value.
        name: &'static str,
        /// Why not.
        reason: String,
    },
    /// A value outside its bounds, or not a number.
    #[error("{name} is {value}: it must lie between {least} and {most} (tuning.{name})")]
    OutOfBounds {
        /// The value's name.
        name: &'static str,
        /// The value.
        value: f64,
        /// Its lower bound.
        least: f64,
        /// Its upper bound.
        most: f64,
    },
    /// The values are in force already.
    #[error("nothing changes: these values are in force already")]
    Unchanged,
}

impl Config {
    /// The rule for requests to tune.
    #[must_use]
    pub const fn tuning_rule(&self) -> TuningRule {
        TuningRule {
            bounds: self.tuning.bounds(),
            gain: match self.outer_loop {
                OuterLoopSection::Proportional {
                    gain_per_s: [x, y], ..
                } => Some(Velocity::new(x, y)),
                _ => None,
            },
            point_distance: self.law.point_distance_m,
            kind: self.outer_loop.kind(),
            governed: self.governor.enabled,
        }
    }
}

impl TuningRule {
    /// Whether the pilot may be given `tuning` while `in_force` is in force.
    ///
    /// # Errors
    ///
    /// Why not.
    pub fn check(&self, tuning: &Tuning, in_force: Option<&Tuned>) -> Result<(), TuningError> {
        let bounds = self.bounds.ok_or(TuningError::Disabled)?;
        if let Some(gain) = tuning.gain {
            let reason = || match self.kind {
                "proportional" => "tuning.gain_per_s has no bounds in the configuration".to_owned(),
                kind => no_gains(kind),
            };
            for gain in [gain.x, gain.y] {
                within("gain_per_s", gain, bounds.gain, reason)?;
            }
        }
        if let Some(distance) = tuning.point_distance {
            let reason = || {
                if self.governed {
                    GOVERNED.to_owned()
                } else {
                    "tuning.point_distance_m has no bounds in the configuration".to_owned()
                }
            };
            within("point_distance_m", distance, bounds.point_distance, reason)?;
        }
        if *tuning == Tuning::default() {
            return Err(TuningError::Nothing);
        }
        match in_force {
            Some(tuned) if tuned.has(tuning) => Err(TuningError::Unchanged),
            _ => Ok(()),
        }
    }

    /// Whether `tuned` differs from the configuration.
    #[must_use]
    pub fn differs(&self, tuned: &Tuned) -> bool {
        tuned.gain != self.gain
            || tuned.point_distance != self.point_distance
            || tuned.wanted_point_distance != self.point_distance
    }
}

fn within(
    name: &'static str,
    value: f64,
    bounds: Option<[f64; 2]>,
    reason: impl FnOnce() -> String,
) -> Result<(), TuningError> {
    let Some([least, most]) = bounds else {
        return Err(TuningError::Fixed {
            name,
            reason: reason(),
        });
    };
    if (least..=most).contains(&value) {
        Ok(())
    } else {
        Err(TuningError::OutOfBounds {
            name,
            value,
            least,
            most,
        })
    }
}
