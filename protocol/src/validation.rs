//! The limits of a sane configuration.
//!
//! The board refuses what is outside, whatever the host believes; the host
//! asks the same function first, so that a person reads which line to correct.

use core::fmt;
use core::ops::RangeInclusive;

use crate::{Configuration, MAX_POSE_AGE_CEILING_MS};

/// Pulses that servos and speed controllers for model cars understand, in µs.
const PULSE_US: RangeInclusive<u16> = 800..=2_200;
/// The neutral pulse that the board sends from its start until it is configured,
/// in µs: the middle of what remote controls send.
const NEUTRAL_AT_START_US: u16 = 1_500;
const DEADBAND_US: RangeInclusive<u16> = 0..=200;
/// Up to the whole width of [`PULSE_US`], which is no limit at all.
const SLEW_US: RangeInclusive<u16> = 1..=1_400;
/// A servo turns about 1 rad in 600 µs; horn and linkage divide or multiply that by a few.
const SERVO_GAIN_US_PER_RAD: RangeInclusive<u16> = 50..=5_000;
/// Keeps the products of the speed loop within 32 bits.
const LOOP_GAIN: RangeInclusive<u16> = 0..=5_000;
const INTEGRAL_LIMIT_US: RangeInclusive<u16> = 0..=700;
const PULSE_DISTANCE_UM: RangeInclusive<u16> = 1..=u16::MAX;
const MAX_SPEED_MM_S: u16 = 20_000;

/// A value of a [`Configuration`] that the board refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} is {value}, but must be {lowest} to {highest}")]
pub struct ConfigurationError {
    /// Which value.
    pub field: ConfigurationField,
    /// What it is.
    pub value: i32,
    /// The lowest value allowed, given the other values.
    pub lowest: i32,
    /// The highest value allowed, given the other values.
    pub highest: i32,
}

macro_rules! fields {
    ($($field:ident = $path:literal,)*) => {
        /// A value of a [`Configuration`], by name.
        ///
        /// Shown as its path in the structure. (An enumeration and not the
        /// path itself: on the board a string would take up SRAM.)
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum ConfigurationField {
            $(#[doc = concat!("`", $path, "`")] $field,)*
        }

        impl fmt::Display for ConfigurationField {
            fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str(match self {
                    $(Self::$field => $path,)*
                })
            }
        }
    };
}

fields! {
    ServoCentre = "servo.centre_us",
    ServoGainMagnitude = "magnitude of servo.gain_us_per_rad",
    ServoMin = "servo.min_us",
    ServoMax = "servo.max_us",
    ServoSlew = "servo.slew_us_per_20ms",
    EscNeutral = "esc.neutral_us",
    EscDeadband = "esc.deadband_us",
    EscMin = "esc.min_us",
    EscMax = "esc.max_us",
    EscSlew = "esc.slew_us_per_20ms",
    EscBrake = "esc.brake_us",
    PulseDistance = "speed.pulse_distance_um",
    FeedForward = "speed.feed_forward_us_per_m_s",
    Proportional = "speed.proportional_us_per_m_s",
    Integral = "speed.integral_us_per_m",
    IntegralLimit = "speed.integral_limit_us",
    MaxForward = "speed.max_forward_mm_s",
    MaxReverse = "speed.max_reverse_mm_s",
    MaxPoseAge = "max_pose_age_ms",
}

// Inlined into a caller that only asks whether there is an error, this comes
// down to two comparisons.
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

impl Configuration {
    /// Whether a board can follow this configuration.
    ///
    /// # Errors
    ///
    /// The first value that is outside its limits, with the limits.
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
        // After a reset in mid-drive the ESC is still armed: what the board
        // sends then must not drive this car either.
        let starts_neutral = NEUTRAL_AT_START_US - deadband..=NEUTRAL_AT_START_US + deadband;
        check(Field::EscNeutral, neutral, starts_neutral)?;
        let min = esc.min_us;
        // Within the deadband nothing brakes.
        let weakest_brake = neutral - deadband - 1;
        check(Field::EscMin, min, lowest_pulse..=weakest_brake)?;
        check(
            Field::EscMax,
            esc.max_us,
            neutral + deadband..=highest_pulse,
        )?;
        check(Field::EscSlew, esc.slew_us_per_20ms, SLEW_US)?;
        check(Field::EscBrake, esc.brake_us, min..=weakest_brake)?;

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
        check(
            Field::MaxForward,
            speed.max_forward_mm_s,
            1..=MAX_SPEED_MM_S,
        )?;
        check(
            Field::MaxReverse,
            speed.max_reverse_mm_s,
            0..=MAX_SPEED_MM_S,
        )?;

        let ceiling = MAX_POSE_AGE_CEILING_MS;
        check(Field::MaxPoseAge, self.max_pose_age_ms, 1..=ceiling)
    }
}
