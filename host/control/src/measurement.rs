//! What is measured of the car, and what is asked of it from outside.

use crate::{Position, Time, Velocity};

/// A valid pose from the motion capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSample {
    /// Mid-exposure, on the host's clock.
    pub capture: Time,
    /// When the packet arrived.
    pub receive: Time,
    /// Frame number of the motion capture.
    pub frame: i32,
    /// Position of the rigid body's origin on the floor, world frame, in m.
    pub position: Position,
    /// Yaw of the rigid body, in rad, on the circle.
    pub yaw: f64,
}

/// A sample of the inertial measurement unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialSample {
    /// When it was measured, on the host's clock.
    pub time: Time,
    /// Angular velocity about the vertical, in rad/s.
    pub yaw_rate: f64,
    /// Acceleration forward, without gravity, in m/s².
    pub forward_acceleration: f64,
    /// Acceleration to the left, without gravity, in m/s².
    pub left_acceleration: f64,
}

/// A set-point from outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setpoint {
    /// When it arrived.
    pub time: Time,
    /// Where P should be, in m; none for a velocity alone.
    pub position: Option<Position>,
    /// How fast P should move, in m/s.
    pub velocity: Velocity,
}

impl Setpoint {
    /// Whether every number of it is one.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.velocity.iter().all(|value| value.is_finite())
            && self
                .position
                .is_none_or(|position| position.iter().all(|value| value.is_finite()))
    }
}
