//! Stability of the steady motion under the linearising laws: the paper's section on
//! structural stability, and its appendix.
//!
//! The commanded velocity of P is constant. The steady motion of the car is then straight:
//! yaw in the direction of that velocity, and yaw rate, sideslip and steering zero. It does
//! not depend on the positions of G and P, so the states are the angles alone: yaw, yaw
//! rate, sideslip and steering under the
//! [`FrontPointLaw`](singletrack_control::FrontPointLaw) (four states), and yaw, yaw rate and
//! sideslip under the [`VelocityPointLaw`](singletrack_control::VelocityPointLaw), which
//! commands the steering angle itself (three). The law assumes the centre of mass `dl` behind
//! its true position.
//!
//! Yaw is relative to the direction of the commanded velocity; nothing else depends on that
//! direction.

mod attraction;
mod characteristic;
mod closed_loop;
mod cycles;
mod hopf;
mod interval;
mod lyapunov;
mod motion;
mod sampled;
mod vector_field;

pub use attraction::Attraction;
pub use characteristic::CharacteristicPolynomial;
pub use closed_loop::{Belief, ClosedLoop, Law, Saturation, StabilityError};
pub use cycles::{CycleBranch, LimitCycle};
pub use hopf::{
    Criticality, HopfPoint, OneLength, critical_speed, hopf_points, infinite_speed_limit,
    smallest_point_distance,
};
pub use lyapunov::Lyapunov;
pub use motion::Basin;
pub use sampled::{
    Ages, Compensation, IrregularLimits, LyapunovFunction, MarginLimits, Prediction, RandomLosses,
    SampledLoop, SamplingError, Servo, Switched, Timing, UnstablePattern, first_unstable_speed,
    least_point_distance,
};
pub use vector_field::Eigenvalues;
