//! `[outer_loop]`: from the position that P should have to its velocity.

use serde::{Deserialize, Serialize};
use singletrack_control::{OpenLoop, ProportionalLoop, Reference, TrackingLoop, Velocity};

use super::{ConfigError, choice::choice, kind::Written, section::section};

/// The position loop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case", try_from = "OuterLoopKeys")]
pub enum OuterLoopSection {
    /// Proportional, per axis.
    Proportional {
        /// Gains along x and y, per second.
        gain_per_s: [f64; 2],
        /// Whether the reference's velocity is added.
        feed_forward: bool,
    },
    /// None: the reference's velocity goes to the law.
    OpenLoop {},
}

section! {
    /// From the position that P should have to the velocity that it should have.
    "outer_loop" => pub(super) OuterLoopKeys;
    [];

    /// The loop: "proportional", or "open-loop" for references that are velocities.
    kind: OuterLoopKind, example OuterLoopKind::Proportional;
    /// Gains along x and y.
    gain_per_s: Option<[f64; 2]> = None, text "0 or above", example [1.0, 1.0];
    /// Adds the reference's velocity: P then follows without lag. With
    /// `compensation.actuation` it is the velocity at the moment at which the command acts, and
    /// the reference's acceleration leads the speed by the motor's lag.
    feed_forward: Option<bool> = None, otherwise false;
}

choice! {
    /// The kinds of loop.
    pub(super) OuterLoopKind;
    /// See [`OuterLoopSection::Proportional`].
    Proportional = "proportional";
    /// See [`OuterLoopSection::OpenLoop`].
    OpenLoop = "open-loop";
}

impl TryFrom<OuterLoopKeys> for OuterLoopSection {
    type Error = String;

    fn try_from(keys: OuterLoopKeys) -> Result<Self, String> {
        Ok(match keys.kind {
            OuterLoopKind::Proportional => Self::Proportional {
                gain_per_s: Written::of(&keys)?.need("gain_per_s", keys.gain_per_s)?,
                feed_forward: keys.feed_forward.unwrap_or_default(),
            },
            // The gains may stay in a file whose loop is opened for a while.
            OuterLoopKind::OpenLoop => Self::OpenLoop {},
        })
    }
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

    /// Refuses gains that are negative or not finite.
    ///
    /// # Errors
    ///
    /// The first such gain.
    pub fn validate(&self) -> Result<(), ConfigError> {
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
        Ok(())
    }

    /// Refuses a position loop for a reference without a position.
    ///
    /// # Errors
    ///
    /// The loop does not suit the reference.
    pub fn validate_for(&self, reference: &Reference) -> Result<(), ConfigError> {
        // A set-point from outside may have a position; one that has none passes through.
        if matches!(self, Self::Proportional { .. })
            && !matches!(reference, Reference::External(_))
            && reference.at(0.0).position.is_none()
        {
            return Err(ConfigError::value(
                "outer_loop.kind",
                "proportional",
                "a reference of velocity steps has no position to follow; use \"open-loop\"",
            ));
        }
        Ok(())
    }
}
