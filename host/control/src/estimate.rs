//! The estimated state of the car.

use crate::{Motion, Position, Time};

/// The estimated state of the car at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The time of the state.
    pub time: Time,
    /// Position of the centre of mass G, world frame, in m.
    pub position: Position,
    /// Yaw, in rad, not wrapped.
    pub yaw: f64,
    /// Yaw rate, in rad/s.
    pub yaw_rate: f64,
    /// Sideslip, in rad.
    pub sideslip: f64,
    /// Speed of G, in m/s; negative in reverse.
    pub speed: f64,
    /// Mid-exposure of the last accepted pose.
    pub pose_time: Time,
}

impl Estimate {
    /// The part of the state that the laws use.
    #[must_use]
    pub const fn motion(&self) -> Motion {
        Motion {
            yaw: self.yaw,
            yaw_rate: self.yaw_rate,
            sideslip: self.sideslip,
        }
    }

    /// Age of the last accepted pose at the estimate's time, in s.
    #[must_use]
    pub fn pose_age(&self) -> f64 {
        self.time.seconds_since(self.pose_time)
    }
}
