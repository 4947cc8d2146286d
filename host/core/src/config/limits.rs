//! `[limits]`: what the car may do.

use serde::{Deserialize, Serialize};
use singletrack_control::Limits;

use super::{ConfigError, check};

/// What the car may do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LimitsSection {
    /// Fastest forward.
    pub max_speed_m_s: f64,
    /// Fastest in reverse; 0 disables reverse.
    pub max_reverse_speed_m_s: f64,
    /// Largest change of speed.
    pub max_acceleration_m_s2: f64,
    /// Largest acceleration to the side.
    pub max_lateral_acceleration_m_s2: f64,
    /// Largest steering angle to either side.
    pub max_steering_rad: f64,
    /// Largest steering rate.
    pub max_steering_rate_rad_s: f64,
    /// Speed at which the car turns round.
    pub creep_speed_m_s: f64,
    /// A wanted velocity of P below this is standstill.
    pub standstill_speed_m_s: f64,
}

impl Default for LimitsSection {
    fn default() -> Self {
        let limits = Limits::paper();
        Self {
            max_speed_m_s: limits.max_speed,
            max_reverse_speed_m_s: limits.max_reverse_speed,
            max_acceleration_m_s2: limits.max_acceleration,
            max_lateral_acceleration_m_s2: limits.max_lateral_acceleration,
            max_steering_rad: limits.max_steering,
            max_steering_rate_rad_s: limits.max_steering_rate,
            creep_speed_m_s: limits.creep_speed,
            standstill_speed_m_s: limits.standstill_speed,
        }
    }
}

impl LimitsSection {
    /// For the controller of a car with this wheelbase, in m.
    #[must_use]
    pub const fn limits(&self, wheelbase: f64) -> Limits {
        Limits {
            max_speed: self.max_speed_m_s,
            max_reverse_speed: self.max_reverse_speed_m_s,
            max_acceleration: self.max_acceleration_m_s2,
            max_lateral_acceleration: self.max_lateral_acceleration_m_s2,
            wheelbase,
            max_steering: self.max_steering_rad,
            max_steering_rate: self.max_steering_rate_rad_s,
            creep_speed: self.creep_speed_m_s,
            standstill_speed: self.standstill_speed_m_s,
        }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let fastest = self.max_speed_m_s;
        check::positive("limits.max_speed_m_s", fastest, 20.0)?;
        check::within(
            "limits.max_reverse_speed_m_s",
            self.max_reverse_speed_m_s,
            0.0..=20.0,
        )?;
        check::positive(
            "limits.max_acceleration_m_s2",
            self.max_acceleration_m_s2,
            50.0,
        )?;
        check::positive(
            "limits.max_lateral_acceleration_m_s2",
            self.max_lateral_acceleration_m_s2,
            50.0,
        )?;
        // The law is singular before 90 degrees.
        check::positive("limits.max_steering_rad", self.max_steering_rad, 1.2)?;
        check::positive(
            "limits.max_steering_rate_rad_s",
            self.max_steering_rate_rad_s,
            50.0,
        )?;
        check::positive("limits.creep_speed_m_s", self.creep_speed_m_s, fastest)?;
        check::positive(
            "limits.standstill_speed_m_s",
            self.standstill_speed_m_s,
            fastest,
        )
    }
}
