//! Stability of the steady motion under the linearising laws: the paper's section on
//! structural stability, and its appendix.
//!
//! P is to move with a constant velocity. The car's steady motion then is straight on:
//! yaw along that velocity, yaw rate, sideslip and steering zero. Where G and P are
//! does not matter to it, so what is looked at are the angles alone: yaw, yaw rate,
//! sideslip and steering under the [`FrontPointLaw`](singletrack_control::FrontPointLaw)
//! (four states), yaw, yaw rate and sideslip under the
//! [`VelocityPointLaw`](singletrack_control::VelocityPointLaw), which commands the
//! steering angle itself (three). The law believes the centre of mass to be `dl`
//! behind where it is.
//!
//! Yaw is counted from the direction of the velocity wanted: nothing else depends on
//! that direction.

mod characteristic;
mod closed_loop;
mod hopf;
mod linearisation;
mod lyapunov;
mod sampled;
mod vector_field;

pub use characteristic::CharacteristicPolynomial;
pub use closed_loop::{Belief, ClosedLoop, Law, StabilityError};
pub use hopf::{
    Criticality, HopfPoint, critical_speed, hopf_points, infinite_speed_limit,
    smallest_point_distance,
};
pub use lyapunov::Lyapunov;
pub use sampled::{MarginLimits, SampledLoop, SamplingError};
