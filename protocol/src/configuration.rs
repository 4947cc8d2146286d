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
        #[serde(with = "postcard::fixint::le")]
        pub max_pose_age_ms: u16,
        /// Whether a normally-closed stop switch is wired: when it opens, the car
        /// stops as for [`crate::EmergencyStop`].
        pub stop_input: bool,
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
        #[serde(with = "postcard::fixint::le")]
        pub centre_us: u16,
        /// Pulse change for one radian to the left, in µs/rad; negative when the
        /// servo is mounted the other way round.
        #[serde(with = "postcard::fixint::le")]
        pub gain_us_per_rad: i16,
        /// Shortest pulse ever sent, in µs.
        #[serde(with = "postcard::fixint::le")]
        pub min_us: u16,
        /// Longest pulse ever sent, in µs.
        #[serde(with = "postcard::fixint::le")]
        pub max_us: u16,
        /// Largest change of the pulse in 20 ms, in µs.
        #[serde(with = "postcard::fixint::le")]
        pub slew_us_per_20ms: u16,
    }
}

structure! {
    /// The pulses that the electronic speed controller understands.
    pub struct EscCalibration {
        /// Pulse at which the motor is free, in µs.
        #[serde(with = "postcard::fixint::le")]
        pub neutral_us: u16,
        /// Half width of the band around neutral in which the motor does not turn, in µs.
        #[serde(with = "postcard::fixint::le")]
        pub deadband_us: u16,
        /// Shortest pulse ever sent, in µs: full brake or reverse.
        #[serde(with = "postcard::fixint::le")]
        pub min_us: u16,
        /// Longest pulse ever sent, in µs: full forward.
        #[serde(with = "postcard::fixint::le")]
        pub max_us: u16,
        /// Largest change of the pulse away from neutral in 20 ms, in µs; towards
        /// neutral the pulse changes at once.
        #[serde(with = "postcard::fixint::le")]
        pub slew_us_per_20ms: u16,
        /// Pulse that brakes, in µs; used by [`FailsafeAction::Brake`].
        #[serde(with = "postcard::fixint::le")]
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
        #[serde(with = "postcard::fixint::le")]
        pub pulse_distance_um: u16,
        /// Feed-forward gain, in µs per m/s.
        #[serde(with = "postcard::fixint::le")]
        pub feed_forward_us_per_m_s: u16,
        /// Proportional gain, in µs per m/s.
        #[serde(with = "postcard::fixint::le")]
        pub proportional_us_per_m_s: u16,
        /// Integral gain, in µs per metre.
        #[serde(with = "postcard::fixint::le")]
        pub integral_us_per_m: u16,
        /// Limit of the integral term, in µs.
        #[serde(with = "postcard::fixint::le")]
        pub integral_limit_us: u16,
        /// Fastest forward speed that is obeyed, in mm/s; faster commands are clamped.
        #[serde(with = "postcard::fixint::le")]
        pub max_forward_mm_s: u16,
        /// Fastest reverse speed that is obeyed, in mm/s. Zero: reverse is refused.
        #[serde(with = "postcard::fixint::le")]
        pub max_reverse_mm_s: u16,
    }
}

enumeration! {
    /// What the ESC is given when the board stops the car by itself.
    pub enum FailsafeAction {
        /// Neutral: the car rolls out.
        Coast = "coast",
        /// The braking pulse until the wheels stand still, at most half a second,
        /// then neutral. Neutral at once after driving in reverse, where the pulse
        /// would not brake.
        Brake = "brake",
    }
}
