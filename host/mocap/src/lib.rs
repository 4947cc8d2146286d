//! Clients without I/O of motion capture systems: poses of rigid bodies over NatNet
//! (OptiTrack), VRPN, and the real-time protocol of Qualisys.
//!
//! The crate opens no socket, reads no clock and allocates nothing (`no_std`).
//!
//! - [`PoseSource`] is what all sessions have in common, and [`Source`] the one that is
//!   configured. [`vrpn`] and [`qualisys`] have their own messages.
//! - [`Session`] is the session of one client with one NatNet server. It gives the whole
//!   pose of every rigid body ([`PoseFrame`]), with the time of the exposure on the
//!   local clock and a bound on its error.
//! - [`codec`] turns datagrams into values, and [`encode`] turns values into
//!   datagrams, each for both sides: server and client.
//! - [`planar`] follows one rigid body in the plane and rejects implausible poses.
//!
//! Every `now_ns` is in nanoseconds of one local monotonic clock. Poses are in a
//! right-handed world frame with z up, in metres; quaternions are x, y, z, w.
//!
//! # Order of the calls
//!
//! The session is sans-IO: its owner has the socket and the clock. At every wake-up
//! the owner calls, in this order, with the time `now`:
//!
//! 1. `handle_*(now, ...)` for every input that has arrived, oldest first;
//! 2. `handle_timeout(now)`, which acts on what did not arrive;
//! 3. `poll_transmit(now)` until it returns `None`, and sends each result;
//! 4. `poll_timeout()`, the time of the next wake-up if no input arrives before.
//!
//! The order matters: without step 1 first, an owner that is late takes its own
//! delay for silence of the other side. Nothing happens before the time of step 4.
//! The handlers pass what happened to the callback `on_output`, in order and before
//! they return. Nothing waits in a queue, so no burst of input can lose an event.
//!
//! # Example
//!
//! One wake-up of the owner; `receive` and `send` are the socket's:
//!
//! ```
//! use std::net::SocketAddr;
//! use singletrack_mocap::{BodyState, Input, Output, PoseSource, Session};
//!
//! fn wake_up<'b>(
//!     session: &mut Session,
//!     now_ns: u64,
//!     received: impl IntoIterator<Item = (SocketAddr, &'b [u8])>,
//!     mut send: impl FnMut(SocketAddr, &[u8]),
//! ) -> Option<u64> {
//!     let on_output = &mut |output: Output<'_>| match output {
//!         Output::Frame(frame) => {
//!             for body in frame.bodies() {
//!                 if let BodyState::Tracked(pose) = body.state {
//!                     println!("{}: {:?} m", body.id, pose.position_m);
//!                 }
//!             }
//!         }
//!         other => println!("{other:?}"),
//!     };
//!     for (source, bytes) in received {
//!         session.handle_input(now_ns, Input::Datagram { source, bytes }, on_output);
//!     }
//!     session.handle_timeout(now_ns, on_output);
//!     while let Some(transmit) = session.poll_transmit(now_ns) {
//!         send(transmit.destination, &transmit.bytes);
//!     }
//!     session.poll_timeout()
//! }
//! ```
//!
//! The example `natnet_client` is a complete client over `std::net::UdpSocket`.

#![no_std]

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

mod body;
mod clock;
pub mod codec;
mod config;
mod consistency;
pub mod encode;
mod names;
pub mod planar;
mod pose_source;
pub mod qualisys;
mod session;
mod source;
mod stream;
pub mod vrpn;
mod words;

pub use body::{
    Bodies, Body, BodyPose, BodyState, CaptureTime, CaptureTimeSource, InvalidBody, UpAxis,
};
pub use config::{
    DEFAULT_COMMAND_PORT, DEFAULT_DATA_PORT, DEFAULT_MULTICAST_GROUP, DEFAULT_QUALISYS_PORT,
    DEFAULT_QUATERNION_NORM_TOLERANCE, DEFAULT_VRPN_PORT, Protocol, SessionConfig,
    SessionConfigError, Timing, Transport,
};
pub use names::{Binding, BodyNames, NameText, Names};
pub use pose_source::{
    Connected, Input, LocalEnd, Output, Phase, PoseFrame, PoseSource, RestartReason,
    SessionCounters, SessionEvent, Stream, Transmit,
};
pub use session::Session;
pub use source::Source;
pub use stream::StreamSession;
// The names by which the workspace's other crates know what is recorded of `planar`.
#[doc(hidden)]
pub use planar::{Observation, PlanarPose as Pose, PoseLimits, PoseState, RejectReason};
