//! Calibration and limits, sent by the host.
//!
//! The host keeps them in one file. The board loses them at a reset and refuses to
//! arm without them.
//!
//! The board refuses values outside of the limits of a valid configuration. The host
//! calls the same function first, so that its error names the line to correct.

use core::ops::RangeInclusive;

use crate::words;

use crate::{
    Configure, MAX_POSE_AGE_CEILING_MS, Message,
    codec::{Field, Writer, enumeration, structure},
    frame::crc32,
};

structure! {
    /// Everything that the board must know about the car that it is built into.
    pub struct Configuration {
        /// The steering servo.
        pub servo: ServoCalibration,
        /// The electronic speed controller.
        pub esc: EscCalibration,
        /// The speed loop closed on the motor pulses.
        pub speed: SpeedLoop,
        /// What the ESC is given when the board stops the car by itself.
        pub failsafe: FailsafeAction,
        /// Oldest pose that a [`crate::Drive`] may be based on, in milliseconds;
        /// 1 to [`crate::MAX_POSE_AGE_CEILING_MS`].
        pub max_pose_age_ms: u16,
        /// Whether a normally-closed stop switch is wired: when it opens, the car
        /// stops as for [`crate::EmergencyStop`].
        pub stop_input: bool,
        /// Whether the ESC's supply is switched by the kill output: on only while
        /// the board is armed and healthy.
        pub kill_output: bool,
        /// The longest time that the car rolls at neutral after a drive, in
        /// milliseconds: motor pulses beyond it mean that the ESC drives at neutral.
        pub max_roll_out_ms: u16,
        /// The car that this configuration is for; it must be the board's
        /// ([`crate::Identity`]).
        pub car_id: u16,
        /// How the IMU is mounted.
        pub imu_axes: ImuAxes,
    }
}

impl Configuration {
    /// Length in bytes: a [`Configure`] without the request number.
    const LENGTH: usize = Configure::PAYLOAD_LENGTH - 1;

    /// Identifies this configuration in [`crate::Arm`], [`crate::Acknowledgement`]
    /// and [`crate::Status`]: the CRC-32 of its encoded bytes. Never zero, which
    /// stands for no configuration.
    #[inline(never)]
    pub fn hash(&self) -> u32 {
        let mut buffer = [0; Self::LENGTH];
        self.write(&mut Writer::new(&mut buffer));
        crc32(&buffer).max(1)
    }
}

structure! {
    /// Maps steering angles to servo pulses.
    pub struct ServoCalibration {
        /// Pulse that steers straight on (the trim), in µs.
        pub centre_us: u16,
        /// Pulse change for one radian to the left, in µs/rad; negative when the
        /// servo is mounted the other way round.
        pub gain_us_per_rad: i16,
        /// Shortest pulse ever sent, in µs.
        pub min_us: u16,
        /// Longest pulse ever sent, in µs.
        pub max_us: u16,
        /// Largest change of the pulse in 20 ms, in µs.
        pub slew_us_per_20ms: u16,
    }
}

structure! {
    /// The pulses that the electronic speed controller understands.
    pub struct EscCalibration {
        /// What a pulse below neutral does.
        pub kind: EscKind,
        /// Pulse at which the motor is free, in µs.
        pub neutral_us: u16,
        /// Half width of the band around neutral in which the motor does not turn, in µs.
        pub deadband_us: u16,
        /// Shortest pulse ever sent, in µs: full brake or reverse.
        pub min_us: u16,
        /// Longest pulse ever sent, in µs: full forward.
        pub max_us: u16,
        /// Largest change of the pulse away from neutral in 20 ms, in µs; towards
        /// neutral the pulse changes at once.
        pub slew_us_per_20ms: u16,
        /// Pulse that brakes, in µs, at most half a second at a time; not used with
        /// an ESC that has no brake ([`EscKind::ForwardReverse`]).
        pub brake_us: u16,
    }
}

structure! {
    /// The speed loop that the board closes on the motor pulses.
    ///
    /// The pulse beyond the deadband is
    /// `feed_forward · v + proportional · e + ∫ integral · e dt`, with the error
    /// `e = v - measured`, and the integral limited to `± integral_limit_us`.
    pub struct SpeedLoop {
        /// Distance that the car rolls in one motor pulse, in µm.
        pub pulse_distance_um: u16,
        /// Feed-forward gain, in µs per m/s.
        pub feed_forward_us_per_m_s: u16,
        /// Proportional gain, in µs per m/s.
        pub proportional_us_per_m_s: u16,
        /// Integral gain, in µs per metre.
        pub integral_us_per_m: u16,
        /// Limit of the integral term, in µs.
        pub integral_limit_us: u16,
        /// Fastest forward speed that is obeyed, in mm/s; faster commands are clamped.
        pub max_forward_mm_s: u16,
        /// Fastest reverse speed that is obeyed, in mm/s. Zero: reverse is refused.
        pub max_reverse_mm_s: u16,
    }
}

enumeration! {
    /// What the ESC does with a pulse below neutral.
    pub enum EscKind {
        /// After driving forward, the first pulse brakes, and only a second one,
        /// after neutral, is reverse: most ESCs of model cars.
        Car = "car",
        /// It is reverse at once, also as the first one: crawlers and boats. No
        /// pulse brakes.
        ForwardReverse = "forward-reverse",
        /// It brakes, always: a VESC with pulse input, current control without
        /// reverse.
        Vesc = "vesc",
    }
}

structure! {
    /// The mounting of the IMU: the chip's axis along each axis of the car.
    pub struct ImuAxes {
        /// Points forward.
        pub forward: ImuAxis,
        /// Points to the left.
        pub left: ImuAxis,
        /// Points up.
        pub up: ImuAxis,
    }
}

enumeration! {
    /// A direction as printed on the IMU's chip.
    pub enum ImuAxis {
        /// Along x.
        PlusX = "+x",
        /// Against x.
        MinusX = "-x",
        /// Along y.
        PlusY = "+y",
        /// Against y.
        MinusY = "-y",
        /// Along z.
        PlusZ = "+z",
        /// Against z.
        MinusZ = "-z",
    }
}

impl ImuAxis {
    /// The number of the axis: 0 for x, 1 for y, 2 for z.
    pub const fn index(self) -> u8 {
        self as u8 >> 1
    }

    /// Whether the direction is against the axis.
    pub const fn is_negative(self) -> bool {
        self as u8 & 1 != 0
    }
}

impl ImuAxes {
    /// The axes as printed: x forward, y left, z up.
    pub const AS_PRINTED: Self = Self {
        forward: ImuAxis::PlusX,
        left: ImuAxis::PlusY,
        up: ImuAxis::PlusZ,
    };

    /// Whether this is a mounting: three different axes that form a right-handed
    /// system, as the chip's own do. There are 24.
    pub const fn is_mounting(self) -> bool {
        let (forward, left, up) = (self.forward.index(), self.left.index(), self.up.index());
        if forward == left || left == up || up == forward {
            return false;
        }
        // xyz, yzx and zxy are right-handed; every change of a sign mirrors.
        let rotated = left == (forward + 1) % 3;
        let mirrored = self.forward.is_negative() ^ self.left.is_negative() ^ self.up.is_negative();
        rotated != mirrored
    }
}

enumeration! {
    /// What the ESC is given when the board stops the car by itself.
    pub enum FailsafeAction {
        /// Neutral: the car rolls out.
        Coast = "coast",
        /// The braking pulse until the wheels stand still or speed up again, at most
        /// half a second, then neutral. Neutral at once where the pulse would not
        /// brake: after driving in reverse, and with an ESC that has no brake.
        Brake = "brake",
    }
}

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
