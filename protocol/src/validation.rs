//! Limits of a valid configuration.
//!
//! The board refuses values outside of them. The host calls the same function
//! first, so that its error names the line to correct.

use core::ops::RangeInclusive;

use singletrack_words::words;

use crate::{Configuration, EscKind, FailsafeAction, MAX_POSE_AGE_CEILING_MS};

/// Pulse range of servos and speed controllers for model cars, in µs.
const PULSE_US: RangeInclusive<u16> = 800..=2_200;
/// Neutral pulse from the board's start until it is configured, in µs: the middle
/// of the range of remote controls.
const NEUTRAL_AT_START_US: u16 = 1_500;
const DEADBAND_US: RangeInclusive<u16> = 0..=200;
/// The upper end is the width of [`PULSE_US`], which disables the limit.
const SLEW_US: RangeInclusive<u16> = 1..=1_400;
/// A servo turns about 1 rad per 600 µs; horn and linkage scale that by a small
/// factor.
const SERVO_GAIN_US_PER_RAD: RangeInclusive<u16> = 50..=5_000;
/// Keeps the products of the speed loop within 32 bits.
const LOOP_GAIN: RangeInclusive<u16> = 0..=5_000;
const INTEGRAL_LIMIT_US: RangeInclusive<u16> = 0..=700;
/// With a longer distance, the standstill of a slow car takes longer to recognise
/// than the board waits for a pulse; a shorter one is more pulses than it can count.
const PULSE_DISTANCE_UM: RangeInclusive<u16> = 100..=30_000;
const MAX_ROLL_OUT_MS: RangeInclusive<u16> = 200..=30_000;
const MAX_SPEED_MM_S: u16 = 20_000;
/// Pulses in a millisecond at the top speed. The board takes 16; where more come, it
/// measures less than the true speed, and its speed loop adds throttle.
const PULSES_PER_MS: u32 = 12;

/// A value of a [`Configuration`] outside its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} is {value}, but must be {lowest} to {highest}")]
pub struct ConfigurationError {
    /// The field.
    pub field: ConfigurationField,
    /// Its value.
    pub value: i32,
    /// Smallest allowed value, given the other fields.
    pub lowest: i32,
    /// Largest allowed value, given the other fields.
    pub highest: i32,
}

words! {
    /// A field of a [`Configuration`].
    ///
    /// Displayed as its path in the structure. (An enumeration, because a
    /// string would take up SRAM on the board.)
    pub enum ConfigurationField {
        /// `servo.centre_us`
        ServoCentre = "servo.centre_us",
        /// `magnitude of servo.gain_us_per_rad`
        ServoGainMagnitude = "magnitude of servo.gain_us_per_rad",
        /// `servo.min_us`
        ServoMin = "servo.min_us",
        /// `servo.max_us`
        ServoMax = "servo.max_us",
        /// `servo.slew_us_per_20ms`
        ServoSlew = "servo.slew_us_per_20ms",
        /// `esc.neutral_us`
        EscNeutral = "esc.neutral_us",
        /// `esc.deadband_us`
        EscDeadband = "esc.deadband_us",
        /// `esc.min_us`
        EscMin = "esc.min_us",
        /// `esc.max_us`
        EscMax = "esc.max_us",
        /// `esc.slew_us_per_20ms`
        EscSlew = "esc.slew_us_per_20ms",
        /// `esc.brake_us`
        EscBrake = "esc.brake_us",
        /// `speed.pulse_distance_um`
        PulseDistance = "speed.pulse_distance_um",
        /// `speed.feed_forward_us_per_m_s`
        FeedForward = "speed.feed_forward_us_per_m_s",
        /// `speed.proportional_us_per_m_s`
        Proportional = "speed.proportional_us_per_m_s",
        /// `speed.integral_us_per_m`
        Integral = "speed.integral_us_per_m",
        /// `speed.integral_limit_us`
        IntegralLimit = "speed.integral_limit_us",
        /// `speed.max_forward_mm_s`
        MaxForward = "speed.max_forward_mm_s",
        /// `speed.max_reverse_mm_s`
        MaxReverse = "speed.max_reverse_mm_s",
        /// `max_pose_age_ms`
        MaxPoseAge = "max_pose_age_ms",
        /// `failsafe`
        Failsafe = "failsafe",
        /// `max_roll_out_ms`
        MaxRollOut = "max_roll_out_ms",
        /// `imu_axes`
        ImuAxes = "imu_axes",
    }
}

// Inlined into a caller that needs only `is_err`, this reduces to two comparisons.
#[inline(always)]
fn check(
    field: ConfigurationField,
    value: u16,
    allowed: RangeInclusive<u16>,
) -> Result<(), ConfigurationError> {
    if allowed.contains(&value) {
        return Ok(());
    }
    Err(ConfigurationError {
        field,
        value: value.into(),
        lowest: (*allowed.start()).into(),
        highest: (*allowed.end()).into(),
    })
}

impl EscKind {
    /// Whether it can drive backward.
    const fn has_reverse(self) -> bool {
        !matches!(self, Self::Vesc)
    }

    /// Whether a pulse below neutral brakes, at least after driving forward.
    #[must_use]
    pub const fn has_brake(self) -> bool {
        !matches!(self, Self::ForwardReverse)
    }
}

impl Configuration {
    /// Checks all values against their limits.
    ///
    /// # Errors
    ///
    /// The first value outside its limits.
    #[inline]
    pub fn validate(&self) -> Result<(), ConfigurationError> {
        use ConfigurationField as Field;
        let (lowest_pulse, highest_pulse) = (*PULSE_US.start(), *PULSE_US.end());

        let servo = &self.servo;
        let (min, max) = (servo.min_us, servo.max_us);
        check(Field::ServoMin, min, PULSE_US)?;
        check(Field::ServoMax, max, min..=highest_pulse)?;
        check(Field::ServoCentre, servo.centre_us, min..=max)?;
        let gain = servo.gain_us_per_rad.unsigned_abs();
        check(Field::ServoGainMagnitude, gain, SERVO_GAIN_US_PER_RAD)?;
        check(Field::ServoSlew, servo.slew_us_per_20ms, SLEW_US)?;

        let esc = &self.esc;
        let (neutral, deadband) = (esc.neutral_us, esc.deadband_us);
        check(Field::EscDeadband, deadband, DEADBAND_US)?;
        // After a reset while driving the ESC is still armed: the start-up pulse
        // must not drive this car.
        let starts_neutral = NEUTRAL_AT_START_US - deadband..=NEUTRAL_AT_START_US + deadband;
        check(Field::EscNeutral, neutral, starts_neutral)?;
        let min = esc.min_us;
        // A pulse within the deadband does not brake.
        let weakest_brake = neutral - deadband - 1;
        check(Field::EscMin, min, lowest_pulse..=weakest_brake)?;
        check(
            Field::EscMax,
            esc.max_us,
            neutral + deadband..=highest_pulse,
        )?;
        check(Field::EscSlew, esc.slew_us_per_20ms, SLEW_US)?;
        if esc.kind.has_brake() {
            check(Field::EscBrake, esc.brake_us, min..=weakest_brake)?;
        }

        let speed = &self.speed;
        check(
            Field::PulseDistance,
            speed.pulse_distance_um,
            PULSE_DISTANCE_UM,
        )?;
        check(Field::FeedForward, speed.feed_forward_us_per_m_s, LOOP_GAIN)?;
        check(
            Field::Proportional,
            speed.proportional_us_per_m_s,
            LOOP_GAIN,
        )?;
        check(Field::Integral, speed.integral_us_per_m, LOOP_GAIN)?;
        check(
            Field::IntegralLimit,
            speed.integral_limit_us,
            INTEGRAL_LIMIT_US,
        )?;
        // µm/ms are mm/s.
        let measurable_mm_s = u32::from(speed.pulse_distance_um) * PULSES_PER_MS;
        let fastest = measurable_mm_s.min(MAX_SPEED_MM_S.into()) as u16;
        check(Field::MaxForward, speed.max_forward_mm_s, 1..=fastest)?;
        let backward = if esc.kind.has_reverse() { fastest } else { 0 };
        check(Field::MaxReverse, speed.max_reverse_mm_s, 0..=backward)?;

        let ceiling = MAX_POSE_AGE_CEILING_MS;
        check(Field::MaxPoseAge, self.max_pose_age_ms, 1..=ceiling)?;
        let brakes = self.failsafe == FailsafeAction::Brake;
        let may_brake = u16::from(self.esc.kind.has_brake());
        check(Field::Failsafe, brakes.into(), 0..=may_brake)?;
        check(Field::MaxRollOut, self.max_roll_out_ms, MAX_ROLL_OUT_MS)?;
        check(
            Field::ImuAxes,
            u16::from(self.imu_axes.is_mounting()),
            1..=1,
        )
    }
}
