//! Requests and commands of the host.

use serde::{Deserialize, Serialize};

/// A wrapping sequence number. Duplicates and older numbers are refused.
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

/// Asks the board to accept [`Drive`] commands from now on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Arm {
    /// Number of this request, repeated in the answer.
    pub request: Sequence,
    /// [`crate::Configuration::hash`] of the configuration that the host expects on
    /// the board.
    #[serde(with = "postcard::fixint::le")]
    pub configuration_hash: u32,
    /// Board time of the newest telemetry that the host has received. It prevents a
    /// request that was delayed on the line from arming the car.
    #[serde(with = "postcard::fixint::le")]
    pub telemetry_time_us: u32,
}

/// Asks the board to go to neutral and to refuse [`Drive`] commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Disarm {
    /// Number of this request, repeated in the answer.
    pub request: Sequence,
}

/// Asks the board to go to neutral and to stay there until it is reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EmergencyStop {
    /// Number of this request, repeated in the answer.
    pub request: Sequence,
}

/// Steering and speed, with the ages of the telemetry and the pose behind them.
///
/// Not acknowledged; [`crate::Telemetry::last_sequence`] reports the last accepted
/// one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Drive {
    /// Must be newer than the last accepted one.
    pub sequence: Sequence,
    /// Speed of the rear axle along the car, forward positive, in mm/s.
    #[serde(with = "postcard::fixint::le")]
    pub speed_mm_s: i16,
    /// Steering angle of the front wheels, left positive, in units of 100 µrad.
    #[serde(with = "postcard::fixint::le")]
    pub steering_100urad: i16,
    /// Board time of the newest telemetry that the host had received. From it the
    /// board measures the age of this command with its own clock.
    #[serde(with = "postcard::fixint::le")]
    pub telemetry_time_us: u32,
    /// Age, at `telemetry_time_us`, of the pose behind this command, from the
    /// mid-exposure of the last *accepted* pose; holding a pose and dead reckoning
    /// do not renew it. In milliseconds, rounded up; `u16::MAX` for none.
    #[serde(with = "postcard::fixint::le")]
    pub pose_age_ms: u16,
}
