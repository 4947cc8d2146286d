//! Requests and commands of the host.

use serde::{Deserialize, Serialize};

use crate::codec::{Field, Reader, Writer, structure};

/// A wrapping sequence number; the newest wins, duplicates and older ones are
/// refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sequence(pub u8);

impl Sequence {
    /// The number after this one.
    #[must_use]
    pub const fn next(self) -> Self {
        Self(self.0.wrapping_add(1))
    }

    /// Whether this number comes after `other`, by at most 127 steps.
    #[must_use]
    pub const fn is_newer_than(self, other: Self) -> bool {
        matches!(self.0.wrapping_sub(other.0), 1..=127)
    }
}

impl Field for Sequence {
    fn write(&self, writer: &mut Writer<'_>) {
        self.0.write(writer);
    }

    fn read(reader: &mut Reader<'_>) -> Self {
        Self(u8::read(reader))
    }
}

structure! {
    /// Asks the board to accept [`Drive`] commands from now on.
    pub struct Arm {
        /// Names this request in the answer.
        pub request: Sequence,
        /// [`crate::Configuration::hash`] of the configuration that the host
        /// believes the board has.
        pub configuration_hash: u32,
        /// Board time of the newest telemetry that the host has seen. A request
        /// that has waited in a stuck line must not arm the car.
        pub telemetry_time_us: u32,
    }
}

structure! {
    /// Asks the board to go to neutral and to refuse [`Drive`] commands.
    pub struct Disarm {
        /// Names this request in the answer.
        pub request: Sequence,
    }
}

structure! {
    /// Asks the board to go to neutral and to stay there until it is reset.
    pub struct EmergencyStop {
        /// Names this request in the answer.
        pub request: Sequence,
    }
}

structure! {
    /// Steering and speed, with the two ages that let the board judge them.
    ///
    /// Not acknowledged: [`crate::Telemetry::last_sequence`] states what the board
    /// accepted.
    pub struct Drive {
        /// Newest wins.
        pub sequence: Sequence,
        /// Speed of the rear axle along the car, forward positive, in mm/s.
        pub speed_mm_s: i16,
        /// Steering angle of the front wheels, left positive, in units of 100 µrad.
        pub steering_100urad: i16,
        /// Board time of the newest telemetry that the host had seen: the board
        /// measures with its own clock how old this command is.
        pub telemetry_time_us: u32,
        /// Age, at `telemetry_time_us`, of the pose behind this command: the
        /// mid-exposure of the last pose that was *accepted*, which neither holding
        /// nor coasting renews. In milliseconds, rounded up; `u16::MAX` for none.
        pub pose_age_ms: u16,
        /// Brake down to `speed_mm_s` where the ESC can: the host is stopping the
        /// car. Without it, a car that is too fast gets neutral.
        pub brake: bool,
    }
}

structure! {
    /// Bare pulses, to find out what servo and ESC do with them. The board clamps
    /// them to its limits and to [`JOG_LIMIT_US`](crate::JOG_LIMIT_US); what it
    /// gives is in [`crate::Telemetry`].
    ///
    /// Accepted instead of [`Drive`]: an armed board takes one or the other until it
    /// is disarmed. It rests on no pose. Not acknowledged, as [`Drive`].
    pub struct Jog {
        /// Newest wins; the same numbers as those of [`Drive`].
        pub sequence: Sequence,
        /// Board time of the newest telemetry that the host had seen.
        pub telemetry_time_us: u32,
        /// Servo pulse, in µs.
        pub servo_us: u16,
        /// ESC pulse, in µs.
        pub esc_us: u16,
    }
}
