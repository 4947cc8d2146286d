//! The mathematics of the car: model, linearising laws, tracking and estimation.
//!
//! SI units and radians throughout. The world frame lies on the floor, z up;
//! yaw, yaw rate, sideslip and steering are positive to the left
//! (counter-clockwise seen from above). The car's axes are forward, left, up.
//!
//! Nothing here reads a clock, allocates without the feature `alloc`, or calls the platform's
//! mathematics library: the same inputs give the same bits in every build, on every machine.
//!
//! The vehicle models are generic over the [`Number`], so that an analysis can differentiate
//! the same equations that the simulator runs.
//!
//! Equation numbers refer to Bascetta, Farina, Gabrielli, Matteucci, "A feedback
//! linearisation algorithm for single-track models with structural stability
//! properties".

#![no_std]

#[cfg(any(feature = "alloc", test))]
extern crate alloc;
#[cfg(test)]
extern crate std;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

mod actuation;
#[cfg(feature = "alloc")]
mod boxed_loop;
mod calibration;
mod compensation;
mod convex_area;
mod estimator;
mod governor;
mod law;
mod measurement;
mod mpc;
mod neighbours;
mod number;
mod outer_loop;
mod reference;
mod riccati;
mod safety_filter;
mod setpoint;
mod single_track;
pub mod statistics;
mod steering_map;
mod stop;
mod tracking;
mod words;

pub use actuation::{Actuation, Ahead, Lead, LimitedLaw, Limits};
#[cfg(feature = "alloc")]
pub use boxed_loop::BoxedLoop;
pub use calibration::{
    Calibration, CalibrationConfig, CalibrationEstimate, CalibrationParameter, student_quantile,
};
pub use compensation::{ActuatorModel, Predicted, Predictor};
pub use convex_area::{AreaError, ConvexArea, MAX_AREA_CORNERS, Side};
pub use estimator::{CarPose, Estimator, EstimatorConfig, MarkerLoss, PoseVerdict};
pub use governor::{Governor, GovernorConfig, Room, SlowedBy};
pub use law::{
    FrontPointCommand, FrontPointLaw, LawError, Singularity, VelocityPointCommand,
    VelocityPointLaw, front_point, front_point_velocity, velocity_point,
};
pub use measurement::{
    Covariance, Estimate, InertialSample, Motion, PoseSample, Position, Time, Velocity,
    angle_between, direction, unwrap_near, wrap,
};
pub use mpc::{DelayedMpc, MAX_DELAY_TICKS, MPC_STAGES, MpcConfig, MpcError, MpcLoop, MpcVerdict};
pub use neighbours::{
    Expected, MAX_NEIGHBOURS, NeighbourConfig, NeighbourSample, NeighbourSides, Neighbours,
};
pub use number::{Functions, Libm, Number};
pub use outer_loop::{
    LqiAxis, LqiConfig, LqiError, LqiLoop, OpenLoop, OuterLoop, ProportionalLoop, TrackingInput,
};
pub use reference::{
    Circle, External, FigureOfEight, MAX_PATH_POINTS, MAX_VELOCITY_STEPS, MAX_WAYPOINTS, Path,
    PathSpeed, Reference, ReferenceError, ReferencePoint, Start, VelocityStep, VelocitySteps,
    Waypoint, Waypoints,
};
pub use riccati::{QuadraticRegulator, Regulated, RiccatiError};
pub use safety_filter::{
    Filtered, GENTLE_BEND, MAX_STEERING_TICKS, ROOM_DIRECTIONS, SafetyConfig, SafetyConfigError,
    SafetyFilter, SafetyInput, StopBox,
};
pub use setpoint::{
    Demand, MAX_TRAJECTORY_POINTS, Setpoint, SetpointError, SetpointStamp, SpeedDemand,
    SteeringDemand, Trajectory, TrajectoryPiece, TrajectoryPoint,
};
pub use single_track::{
    AxleForces, Axles, GRAVITY, LateralMotion, LateralRate, RelaxedSingleTrack, SingleTrack,
    SingleTrackDerivative, SingleTrackState, SlipAngles, Tyres, VehicleParameterError,
    VehicleParameters,
};
pub use steering_map::{
    MAX_STEERING_PAIRS, SteeringMap, SteeringTable, SteeringTableError, interpolate,
};
pub use stop::{Stop, along_bend};
pub use tracking::TrackingLoop;
