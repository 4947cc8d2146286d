//! Servo pulse from the steering angle.

use singletrack_protocol::ServoCalibration;

use crate::slew::SlewLimiter;

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

#[cfg(test)]
mod tests {
    use singletrack_protocol::ServoCalibration;

    use super::{Steering, pulse_us};

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
}
