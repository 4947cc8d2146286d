//! The pose of the car, and the verdict on a measured one.

use crate::point::Position;

/// The measured pose of the car, from that of the rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarPose {
    /// Position of the centre of mass G on the floor, world frame, in m.
    pub position: Position,
    /// Yaw of the car, in rad; any multiple of 2π may be added.
    pub yaw: f64,
}

/// The result of handling a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PoseVerdict {
    /// The pose corrected the estimate, or started it.
    Accepted,
    /// The pose is not newer than the last one, or older than the lag of the filter.
    Late,
    /// The pose is outside the innovation gate, or not finite.
    Implausible,
}
