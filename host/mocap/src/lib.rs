//! Motion capture over NatNet: the wire format and the client's session,
//! without a socket, a clock or an allocation.
//!
//! - [`codec`] turns datagrams into values, [`encode`] values into datagrams;
//!   both know the server's side and the client's.
//! - [`Session`] is one client's conversation with one server: it is handed
//!   every datagram with the time it arrived, says what to send, and turns the
//!   frames into [`PoseState`]s of one rigid body.
//!
//! Every `now_ns` is nanoseconds of the local monotonic clock. Poses are in a
//! right-handed world frame with z up, in metres and radians.
#![no_std]

pub mod codec;
pub mod encode;

mod binding;
mod clock;
mod config;
mod counters;
mod gate;
mod order;
mod pose;
mod session;

pub use binding::Binding;
pub use config::{
    Config, ConfigError, DEFAULT_COMMAND_PORT, DEFAULT_DATA_PORT, DEFAULT_MULTICAST_GROUP,
    PoseLimits, RigidBodyName, Timing, Transport,
};
pub use counters::{Counters, RejectedCounts};
pub use pose::{CaptureTimeSource, Pose, PoseState, RejectReason, UpAxis};
pub use session::{
    Connected, Datagram, Event, Observation, Outcome, Phase, RestartReason, Session,
};
