//! The steering servo.

use singletrack_control::{SteeringMap, SteeringTable};
use singletrack_settings::section;

use crate::parameters::ranges::{LAG, NOT_NEGATIVE, POSITIVE};

section! {
    /// True mapping of the steering servo from pulses to angles, and its dynamics.
    ///
    /// The defaults are the nominal calibration. To test calibration errors, change
    /// these values and keep the board's configuration.
    "car.servo" => pub ServoParameters;
    [default];

    /// Pulse for zero steering angle, in µs.
    centre_us: f64 = 1500.0;
    /// Pulse change per radian to the left, in µs/rad.
    gain_us_per_rad: f64 = -800.0, in in_words("finite and not zero", |x| x != 0.0);
    /// Angles over pulses, instead of that line.
    table: Option<SteeringTable> = None;
    /// Mechanical stop on both sides, in rad.
    stop_rad: f64 = 0.55, in in_words("between 0 and 1.5", |x| x > 0.0 && x < 1.5);
    /// Time constant of the first-order lag, in s.
    lag_s: f64 = 0.04, in LAG;
    /// Largest steering rate, in rad/s.
    max_rate_rad_s: f64 = 8.0, in POSITIVE;
    // The servo can measure a pulse only at its end.
    /// Time from the start of a pulse to the servo's response, in µs.
    dead_time_us: u64 = 2_000;
    /// Play: a change of direction moves the wheels only after this change of the
    /// pulse, in µs.
    backlash_us: f64 = 0.0, in NOT_NEGATIVE;
    /// From this time on the wheels keep their angle, in s.
    stuck_from_s: Option<f64> = None, in NOT_NEGATIVE;
    /// From this time on the horn has slipped, in s...
    slips_at_s: Option<f64> = None, in NOT_NEGATIVE;
    /// ...by this angle of the wheels, to the left, in rad.
    slip_rad: f64 = 0.05;
}

impl ServoParameters {
    /// Target angle of a pulse, in rad, within the mechanical stops.
    #[must_use]
    pub fn target(&self, pulse_us: u16) -> f64 {
        self.angle(f64::from(pulse_us))
    }

    fn angle(&self, pulse_us: f64) -> f64 {
        self.free_angle(pulse_us)
            .clamp(-self.stop_rad, self.stop_rad)
    }

    /// The angle of a pulse without the mechanical stops, in rad.
    pub(crate) fn free_angle(&self, pulse_us: f64) -> f64 {
        match &self.table {
            Some(table) => table.angle(pulse_us),
            None => (pulse_us - self.centre_us) / self.gain_us_per_rad,
        }
    }

    /// Follows this map without an error.
    pub fn follow(&mut self, map: &SteeringMap) {
        (self.centre_us, self.gain_us_per_rad) = (map.centre_us, map.gain_us_per_rad);
        self.table.clone_from(&map.table);
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

/// Pulses beyond which no board steers, in µs.
pub const WIDE_US: [f64; 2] = [500.0, 2_500.0];

/// Pairs of pulse in µs and angle in rad between two pulses, for steering that differs from a line
/// with this centre in µs and gain in µs/rad: the wheels turn farther to the left by a fraction,
/// as much less far to the right, and there is a dead band of a width in µs.
#[must_use]
pub fn crooked_steering(
    [centre_us, gain_us_per_rad]: [f64; 2],
    [first_us, last_us]: [f64; 2],
    [farther, band_us]: [f64; 2],
) -> Vec<[f64; 2]> {
    let half = 0.5 * band_us;
    let angle = |pulse_us: f64| {
        let beyond = pulse_us - centre_us;
        let angle = (beyond - beyond.clamp(-half, half)) / gain_us_per_rad;
        angle * (1.0 + farther * angle.signum())
    };
    let mut pulses = vec![first_us, centre_us - half, centre_us + half, last_us];
    pulses.dedup();
    pulses
        .into_iter()
        .map(|pulse_us| [pulse_us, angle(pulse_us)])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crooked_steering_turns_farther_to_one_side_and_rests_in_its_dead_band() {
        let pairs = |farther, band| {
            crooked_steering([1_500.0, -800.0], [1_100.0, 1_900.0], [farther, band])
        };
        let crooked = [[1_100.0, 0.6], [1_500.0, 0.0], [1_900.0, -0.4]];
        assert_eq!(pairs(0.2, 0.0), crooked);
        let table = SteeringTable::new(&pairs(0.2, 80.0)).unwrap();
        for (pulse, angle) in [
            (1_460.0, 0.0),
            (1_540.0, 0.0),
            (1_380.0, 0.12),
            (1_620.0, -0.08),
        ] {
            assert!((table.angle(pulse) - angle).abs() < 1e-12, "{pulse}");
        }
    }

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
