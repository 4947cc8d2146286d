//! The motion of one rigid body in the plane, with a plausibility check.
//!
//! A layer above the camera session for vehicles on a floor. It uses the public
//! interface of the crate only.
//!
//! - [`PlanarTracker`] takes the frames of a [`Session`](crate::Session), finds the
//!   body by its name, projects its pose onto the plane ([`PlanarPose`]), and checks
//!   each pose against the last accepted one ([`PoseLimits`]). The result is one
//!   [`Observation`] a frame.
//! - [`PlanarSession`] is a session and a tracker in one, called as every session
//!   ([order of the calls](crate#order-of-the-calls)).
//!
//! [`Observation`], [`PoseState`], [`PlanarPose`] and [`RejectReason`] are
//! exhaustive: what is recorded of them does not grow silently.

mod config;
mod counters;
mod gate;
mod level;
mod neighbour;
mod observation;
mod session;
mod tracker;

pub use config::{PlanarConfig, PlanarConfigError, PoseLimits, RigidBodyName};
pub use counters::{PlanarCounters, RejectedCounts};
pub use gate::PoseGate;
pub use level::Level;
pub use neighbour::{NEAR_M, Neighbour, OtherBody};
pub use observation::{Observation, PlanarPose, PoseState, RejectReason};
pub use session::{PlanarEvent, PlanarSession};
pub use tracker::PlanarTracker;
