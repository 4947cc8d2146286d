//! Measurements of the car.

use crate::{Position, Time};

/// A valid pose of the rigid body, from the motion capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSample {
    /// Mid-exposure, on the host's clock.
    pub capture: Time,
    /// Arrival of the frame, on the host's clock.
    pub receive: Time,
    /// The server's number of the frame.
    pub frame: i32,
    /// Position of the rigid body's origin on the floor, world frame, in m.
    pub position: Position,
    /// Yaw of the rigid body, in rad; any multiple of 2π may be added.
    pub yaw: f64,
}

/// A sample of the IMU, in the car's axes.
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
