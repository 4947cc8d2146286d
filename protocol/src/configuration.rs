//! Calibration and limits, sent by the host.
//!
//! The host keeps them in one file. The board loses them at a reset and refuses to
//! arm without them.

use crate::{
    Configure, Message,
    codec::{Field, Writer, enumeration, structure},
    crc::crc32,
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
    #[must_use]
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
    #[must_use]
    pub const fn index(self) -> u8 {
        self as u8 >> 1
    }

    /// Whether the direction is against the axis.
    #[must_use]
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
    #[must_use]
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
