//! The feedback linearising laws.
//!
//! Each converts a velocity of its point P into commands for the car, so that P behaves
//! as two independent integrators.

mod front_point;
mod velocity_point;

pub use front_point::{FrontPointCommand, FrontPointLaw};
pub use velocity_point::{VelocityPointCommand, VelocityPointLaw};

/// The motion of the car that the laws measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Yaw ψ, in rad.
    pub yaw: f64,
    /// Yaw rate r, in rad/s.
    pub yaw_rate: f64,
    /// Sideslip β, in rad.
    pub sideslip: f64,
}

/// The state is at a singularity of the law, or not finite.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Singularity {
    /// The front wheels are nearly perpendicular to the velocity: |cos(β - δ)| is too small.
    #[error(
        "cos(sideslip - steering) is {cosine}, at the singularity of the law: \
         sideslip and steering are too far apart"
    )]
    WheelsAcrossVelocity {
        /// cos(β - δ).
        cosine: f64,
    },
    /// The velocity-point law is singular at standstill.
    #[error(
        "the speed is {speed} m/s, at the singularity of the velocity-point law: it needs a car that moves"
    )]
    Standstill {
        /// The speed that the law would command, in m/s.
        speed: f64,
    },
    /// The state or the velocity is not finite.
    #[error("the law was given a state or a velocity that is not finite")]
    NotFinite,
}

/// An invalid parameter of a law.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LawError {
    /// The distance p must not be zero (paper, footnote to equation 3).
    #[error("point_distance_m is {0}: it must be finite and above zero")]
    PointDistance(f64),
    /// The estimate of `l_f` is outside the wheelbase.
    #[error(
        "front_axle_distance_m is {value}: it must lie between 0 and the wheelbase, {wheelbase}"
    )]
    FrontAxleDistance {
        /// The estimate.
        value: f64,
        /// `l_f + l_r`.
        wheelbase: f64,
    },
}
