//! The points whose errors count.

use singletrack_control::VehicleParameters;

/// The point whose errors are the controller's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OwnPoint {
    /// P, in front of the front axle.
    P,
    /// The front axle.
    FrontAxle,
    /// The rear axle.
    RearAxle,
    /// P of the appendix: ahead of G along its velocity.
    VelocityPoint,
}

impl OwnPoint {
    /// How far it is ahead of G on a straight line, in m.
    pub(super) fn reach(self, vehicle: &VehicleParameters) -> f64 {
        match self {
            Self::P => vehicle.front_axle_distance_m + POINT_DISTANCE_M,
            Self::FrontAxle => vehicle.front_axle_distance_m,
            Self::RearAxle => -vehicle.rear_axle_distance_m,
            Self::VelocityPoint => POINT_DISTANCE_M,
        }
    }
}

/// The distance of P from the front axle, in m.
pub(super) const POINT_DISTANCE_M: f64 = 0.35;
