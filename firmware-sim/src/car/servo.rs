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
    /// Play: a change of direction moves the wheels only after this change of the
    /// pulse, in µs.
    pub backlash_us: f64,
    /// From this time on the wheels keep their angle, in s.
    pub stuck_from_s: Option<f64>,
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
            backlash_us: 0.0,
            stuck_from_s: None,
        }
    }
}

impl ServoParameters {
    /// Target angle of a pulse, in rad, within the mechanical stops.
    #[must_use]
    pub fn target(&self, pulse_us: u16) -> f64 {
        self.angle(f64::from(pulse_us))
    }

    fn angle(&self, pulse_us: f64) -> f64 {
        ((pulse_us - self.centre_us) / self.gain_us_per_rad).clamp(-self.stop_rad, self.stop_rad)
    }

    /// Target angle after a further pulse, in rad; `held_us` is the pulse that the
    /// wheels stand for.
    pub(crate) fn target_with_backlash(&self, held_us: &mut f64, pulse_us: u16) -> f64 {
        let pulse_us = f64::from(pulse_us);
        let half = self.backlash_us / 2.0;
        *held_us = held_us.clamp(pulse_us - half, pulse_us + half);
        self.angle(*held_us)
    }

    /// Steering rate towards a target, in rad/s.
    #[must_use]
    pub fn rate(&self, steering: f64, target: f64) -> f64 {
        ((target - steering) / self.lag_s).clamp(-self.max_rate_rad_s, self.max_rate_rad_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backlash_is_lost_at_each_change_of_direction() {
        let servo = ServoParameters {
            backlash_us: 20.0,
            ..ServoParameters::default()
        };
        let mut held = servo.centre_us;
        let mut angle_us = |pulse| {
            let target = servo.target_with_backlash(&mut held, pulse);
            servo.centre_us + target * servo.gain_us_per_rad
        };
        for (pulse, wheels) in [
            (1_510, 1_500.0),
            (1_600, 1_590.0),
            (1_585, 1_590.0),
            (1_500, 1_510.0),
        ] {
            assert!((angle_us(pulse) - wheels).abs() < 1e-9, "{pulse}");
        }
    }
}
