//! `[outer_loop]`: from where P should be to how fast it should move.

use serde::{Deserialize, Serialize};
use singletrack_control::{OpenLoop, ProportionalLoop, Reference, TrackingLoop, Velocity};

use super::ConfigError;

/// The position loop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum OuterLoopSection {
    /// Proportional, per axis.
    Proportional {
        /// Gains along x and y, per second.
        gain_per_s: [f64; 2],
        /// Whether the reference's velocity is added.
        #[serde(default)]
        feed_forward: bool,
    },
    /// None: the reference's velocity goes to the law.
    OpenLoop {},
}

impl OuterLoopSection {
    /// The loop with these values.
    #[must_use]
    pub fn tracking_loop(&self) -> TrackingLoop {
        match *self {
            Self::Proportional {
                gain_per_s: [x, y],
                feed_forward,
            } => TrackingLoop::Proportional(ProportionalLoop {
                gain: Velocity::new(x, y),
                feed_forward,
            }),
            Self::OpenLoop {} => TrackingLoop::OpenLoop(OpenLoop),
        }
    }

    /// Refuses gains that are none, and a loop that has nothing to follow.
    ///
    /// # Errors
    ///
    /// The first value that makes no sense.
    pub fn validate(&self, reference: &Reference) -> Result<(), ConfigError> {
        let Self::Proportional { gain_per_s, .. } = *self else {
            return Ok(());
        };
        for gain in gain_per_s {
            if !(gain.is_finite() && gain >= 0.0) {
                return Err(ConfigError::value(
                    "outer_loop.gain_per_s",
                    gain,
                    "each gain must be finite and not negative",
                ));
            }
        }
        if reference.at(0.0).position.is_none() {
            return Err(ConfigError::value(
                "outer_loop.kind",
                "proportional",
                "a reference of velocity steps has no position to follow; use \"open-loop\"",
            ));
        }
        Ok(())
    }
}
