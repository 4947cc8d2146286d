//! The steering servo.

use serde::{Deserialize, Serialize};

/// True mapping of the steering servo from pulses to angles, and its dynamics.
///
/// The defaults are the nominal calibration. To test calibration errors, change
/// these values and keep the board's configuration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ServoParameters {
    /// Pulse for zero steering angle, in µs.
    pub centre_us: f64,
    /// Pulse change per radian to the left, in µs/rad.
    pub gain_us_per_rad: f64,
    /// Mechanical stop on both sides, in rad.
    pub stop_rad: f64,
    /// Time constant of the first-order lag, in s.
    pub lag_s: f64,
    /// Largest steering rate, in rad/s.
    pub max_rate_rad_s: f64,
    /// Time from the start of a pulse to the servo's response, in µs.
    pub dead_time_us: u64,
}

impl Default for ServoParameters {
    fn default() -> Self {
        Self {
            centre_us: 1500.0,
            gain_us_per_rad: -800.0,
            stop_rad: 0.55,
            lag_s: 0.04,
            max_rate_rad_s: 8.0,
            // The servo can measure a pulse only at its end.
            dead_time_us: 2_000,
        }
    }
}

impl ServoParameters {
    /// Target angle of a pulse, in rad, within the mechanical stops.
    #[must_use]
    pub fn target(&self, pulse_us: u16) -> f64 {
        ((f64::from(pulse_us) - self.centre_us) / self.gain_us_per_rad)
            .clamp(-self.stop_rad, self.stop_rad)
    }

    /// Steering rate towards a target, in rad/s.
    #[must_use]
    pub fn rate(&self, steering: f64, target: f64) -> f64 {
        ((target - steering) / self.lag_s).clamp(-self.max_rate_rad_s, self.max_rate_rad_s)
    }
}
