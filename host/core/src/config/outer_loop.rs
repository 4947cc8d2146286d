//! `[outer_loop]`: from where P should be to how fast it should move.

use serde::{Deserialize, Deserializer, Serialize, de};
use singletrack_control::{OpenLoop, ProportionalLoop, Reference, TrackingLoop, Velocity};

use super::{ConfigError, kind::Keys};

/// The position loop.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
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

/// The keys of all kinds.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Section {
    kind: Kind,
    gain_per_s: Option<[f64; 2]>,
    feed_forward: Option<bool>,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Proportional,
    OpenLoop,
}

impl<'de> Deserialize<'de> for OuterLoopSection {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Section::deserialize(deserializer)?
            .try_into()
            .map_err(de::Error::custom)
    }
}

impl TryFrom<Section> for OuterLoopSection {
    type Error = String;

    fn try_from(section: Section) -> Result<Self, String> {
        let keys = |kind| Keys {
            section: "outer_loop",
            kind,
        };
        match section.kind {
            Kind::Proportional => Ok(Self::Proportional {
                gain_per_s: keys("proportional").need("gain_per_s", section.gain_per_s)?,
                feed_forward: section.feed_forward.unwrap_or(false),
            }),
            // The gains may stay in a file whose loop is opened for a while.
            Kind::OpenLoop => Ok(Self::OpenLoop {}),
        }
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

    /// Refuses gains that are none.
    ///
    /// # Errors
    ///
    /// The first gain that makes no sense.
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

    /// Refuses a position loop for a reference that is a velocity alone.
    ///
    /// # Errors
    ///
    /// That one.
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
