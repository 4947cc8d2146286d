//! Servo pulse from the steering angle, and the limit on the rate of change of a pulse.

use singletrack_protocol::ServoCalibration;

/// The servo: silent until it is configured, then slewing to the last commanded
/// angle.
#[derive(Clone, Debug)]
pub(crate) struct Steering {
    angle_100urad: i16,
    servo: Option<Servo>,
}

#[derive(Clone, Debug)]
struct Servo {
    pulse_us: i16,
    target_us: i16,
    slew: SlewLimiter,
}

impl Steering {
    pub(crate) const fn new() -> Self {
        Self {
            angle_100urad: 0,
            servo: None,
        }
    }

    /// Applies a calibration. A silent servo goes to its pulse at once, because its
    /// position is not known; otherwise the pulse slews.
    pub(crate) fn configure(&mut self, calibration: &ServoCalibration) {
        let target_us = pulse_us(calibration, self.angle_100urad);
        let pulse_us = self
            .servo
            .as_ref()
            .map_or(target_us, |servo| servo.pulse_us);
        self.servo = Some(Servo {
            pulse_us: clamp(calibration, pulse_us.into()),
            target_us,
            slew: SlewLimiter::new(calibration.slew_us_per_20ms),
        });
    }

    /// Sets the target angle, left positive, in units of 100 µrad.
    pub(crate) fn steer(&mut self, calibration: &ServoCalibration, angle_100urad: i16) {
        self.angle_100urad = angle_100urad;
        if let Some(servo) = &mut self.servo {
            servo.target_us = pulse_us(calibration, angle_100urad);
        }
    }

    /// Sets the target pulse, in µs, for jogging. The angle becomes zero: it is that of
    /// the pulse after a new calibration.
    pub(crate) fn jog(&mut self, calibration: &ServoCalibration, jog_us: u16) {
        self.angle_100urad = 0;
        if let Some(servo) = &mut self.servo {
            servo.target_us = clamp(calibration, jog_us.into());
        }
    }

    pub(crate) fn advance(&mut self, elapsed_us: u32) {
        if let Some(servo) = &mut self.servo {
            servo.pulse_us = servo
                .slew
                .approach(servo.pulse_us, servo.target_us, elapsed_us);
        }
    }

    /// The pulse, in µs; `None` while silent.
    pub(crate) fn pulse_us(&self) -> Option<u16> {
        self.servo
            .as_ref()
            .map(|servo| servo.pulse_us.unsigned_abs())
    }
}

#[inline(never)]
fn pulse_us(calibration: &ServoCalibration, angle_100urad: i16) -> i16 {
    // Converts µs per 10,000 units of angle to µs per 2^14 units: a factor of
    // 1.6384, approximated by 26844 / 2^14. Two shifts replace a division, which
    // takes three times as long on the AVR; the error is at most 1/6 µs.
    const SHIFT: u32 = 14;
    const HALF: i32 = 1 << (SHIFT - 1);
    let gain = (i32::from(calibration.gain_us_per_rad) * 26_844 + HALF) >> SHIFT;
    // A validated gain has at most 14 bits here: no overflow.
    let change = (gain * i32::from(angle_100urad) + HALF) >> SHIFT;
    clamp(calibration, i32::from(calibration.centre_us) + change)
}

/// Clamps to the limits of a validated configuration, at most 2200 µs, so that it
/// fits.
fn clamp(calibration: &ServoCalibration, pulse_us: i32) -> i16 {
    pulse_us
        .min(calibration.max_us.into())
        .max(calibration.min_us.into()) as i16
}

/// A stall of the main loop allows at most the change of one servo frame.
const MAX_STEP_US: u16 = 20_000;

/// Fractional bits of the allowed change per microsecond.
///
/// The largest number that fits: the highest rate (1400 µs in 20 ms) and the
/// longest step need 16 bits each. There is no division and no wider
/// multiplication, which would be slow on the AVR in every poll.
const FRACTION_BITS: u32 = 19;

/// A rate of change, with the remainder between polls.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SlewLimiter {
    /// µs of pulse per µs of time, in fixed point.
    rate: u16,
    /// Fraction of a µs of pulse.
    remainder: u32,
}

impl SlewLimiter {
    /// Rounds down: never faster than configured, and less than 2 % slower.
    pub(crate) const fn new(us_per_20ms: u16) -> Self {
        Self {
            rate: (((us_per_20ms as u32) << FRACTION_BITS) / 20_000) as u16,
            remainder: 0,
        }
    }

    /// The pulse after moving from `current` towards `target` for `elapsed_us`.
    #[inline(never)]
    pub(crate) fn approach(&mut self, current: i16, target: i16, elapsed_us: u32) -> i16 {
        if current == target {
            self.remainder = 0;
            return target;
        }
        let elapsed_us = u16::try_from(elapsed_us).map_or(MAX_STEP_US, |us| us.min(MAX_STEP_US));
        let allowed = self.remainder + u32::from(self.rate) * u32::from(elapsed_us);
        self.remainder = allowed & ((1 << FRACTION_BITS) - 1);
        // At most 1401; see `FRACTION_BITS`.
        let allowed = (allowed >> FRACTION_BITS) as i16;
        if current < target {
            current.saturating_add(allowed).min(target)
        } else {
            current.saturating_sub(allowed).max(target)
        }
    }
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::ServoCalibration;

    use super::{SlewLimiter, Steering, pulse_us};

    const CALIBRATION: ServoCalibration = ServoCalibration {
        centre_us: 1_490,
        gain_us_per_rad: -800,
        min_us: 1_100,
        max_us: 1_800,
        slew_us_per_20ms: 90,
    };

    #[test]
    fn angles_are_mapped_by_trim_and_gain_within_the_limits() {
        for (angle_100urad, pulse) in [
            (0, 1_490),
            (1_000, 1_410),
            (-1_000, 1_570),
            (6, 1_490),
            (7, 1_489),
            (-7, 1_491),
            (i16::MAX, 1_100),
            (i16::MIN, 1_800),
        ] {
            assert_eq!(
                pulse_us(&CALIBRATION, angle_100urad),
                pulse,
                "{angle_100urad}"
            );
        }
    }

    #[test]
    fn the_pulse_is_right_to_a_microsecond_for_any_gain_and_angle() {
        for gain_us_per_rad in (-3_000..=3_000).step_by(17) {
            let calibration = ServoCalibration {
                centre_us: 1_500,
                gain_us_per_rad,
                min_us: 800,
                max_us: 2_200,
                ..CALIBRATION
            };
            for angle_100urad in (i16::MIN..=i16::MAX).step_by(487) {
                let exact =
                    1_500.0 + f64::from(gain_us_per_rad) * f64::from(angle_100urad) / 10_000.0;
                let error =
                    f64::from(pulse_us(&calibration, angle_100urad)) - exact.clamp(800.0, 2_200.0);
                // Half a microsecond of rounding, and the error of the scaled gain.
                assert!(
                    error.abs() <= 0.5 + 1.0,
                    "{gain_us_per_rad}, {angle_100urad}: {error}"
                );
            }
        }
    }

    #[test]
    fn the_servo_is_silent_then_centred_then_slews() {
        let mut steering = Steering::new();
        steering.steer(&CALIBRATION, 0);
        steering.advance(1_000_000);
        assert_eq!(steering.pulse_us(), None);
        steering.configure(&CALIBRATION);
        assert_eq!(steering.pulse_us(), Some(1_490));
        steering.steer(&CALIBRATION, -1_000);
        steering.advance(10_000);
        let pulse = steering.pulse_us().unwrap();
        assert!((1_534..=1_535).contains(&pulse), "{pulse}");
        steering.advance(10_000);
        assert_eq!(steering.pulse_us(), Some(1_570));
    }

    #[test]
    fn a_new_calibration_keeps_the_angle_and_its_own_limits() {
        let mut steering = Steering::new();
        steering.configure(&CALIBRATION);
        steering.steer(&CALIBRATION, i16::MIN);
        for _ in 0..10 {
            steering.advance(20_000);
        }
        assert_eq!(steering.pulse_us(), Some(1_800));
        steering.configure(&ServoCalibration {
            max_us: 1_600,
            ..CALIBRATION
        });
        assert_eq!(steering.pulse_us(), Some(1_600));
    }

    #[test]
    fn the_change_in_a_given_time_does_not_depend_on_the_poll_rate() {
        for rate in [1, 7, 90, 1_400] {
            for (polls, every_us) in [(1_000, 1_000), (10_000, 100), (77, 13_000), (50, 20_000)] {
                let mut slew = SlewLimiter::new(rate);
                let mut pulse = 0;
                let mut elapsed = 0;
                for _ in 0..polls {
                    pulse = slew.approach(pulse, i16::MAX, every_us);
                    elapsed += every_us;
                }
                let allowed = i64::from(rate) * i64::from(elapsed) / 20_000;
                let allowed = allowed.min(i16::MAX.into());
                let shortfall = allowed - i64::from(pulse);
                assert!(
                    (0..=1 + allowed / 50).contains(&shortfall),
                    "{rate}: {pulse} of {allowed}"
                );
            }
        }
    }

    #[test]
    fn after_a_stall_of_any_length_the_change_is_that_of_one_servo_frame() {
        for stall_us in [20_000, 20_001, 40_000, 65_535, 65_536, 10_000_000] {
            let mut slew = SlewLimiter::new(96);
            let pulse = slew.approach(0, 1_000, stall_us);
            assert!((95..=96).contains(&pulse), "{pulse} after {stall_us} us");
        }
    }

    #[test]
    fn the_target_is_reached_exactly_from_both_sides() {
        let mut slew = SlewLimiter::new(100);
        assert_eq!(slew.approach(1_500, 1_504, 1_000), 1_504);
        assert_eq!(slew.approach(1_500, 1_496, 1_000), 1_496);
        let pulse = slew.approach(1_500, 1_600, 2_000);
        assert!((1_509..=1_510).contains(&pulse), "{pulse}");
    }

    #[test]
    fn waiting_at_the_target_accumulates_nothing() {
        let mut slew = SlewLimiter::new(100);
        for _ in 0..100 {
            slew.approach(1_500, 1_500, 999);
        }
        assert!(slew.approach(1_500, 1_600, 1_000) <= 1_505);
    }

    #[test]
    fn a_stall_allows_the_change_of_one_servo_frame() {
        let mut slew = SlewLimiter::new(1_400);
        let pulse = slew.approach(0, i16::MAX, u32::MAX);
        assert!((1_399..=1_400).contains(&pulse), "{pulse}");
    }
}
