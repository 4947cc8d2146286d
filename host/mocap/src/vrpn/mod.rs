//! VRPN: trackers of Vicon, of cheap cameras with markers, and of many others.
//!
//! - [`Session`] is a client of one server, over TCP, with poses in datagrams or on TCP.
//! - [`message`] turns bytes into messages, and messages into bytes, for both sides.
//!
//! A body is a sensor of a tracker. VRPN has no frames and no sign of a body that is not seen:
//! the server repeats an old pose, sends zeros, or nothing.

pub mod message;

mod dialogue;
pub(crate) mod senders;

pub use dialogue::VrpnDialogue;
pub use senders::Senders;

use crate::{config::SessionConfig, stream::StreamSession};

/// A client of a VRPN server, without I/O.
pub type Session = StreamSession<VrpnDialogue>;

/// A session that follows a sensor of the tracker `body`, or all bodies.
pub(crate) fn session(config: SessionConfig, sensor: i32, body: Option<&str>) -> Session {
    let dialogue = VrpnDialogue::new(sensor, body);
    StreamSession::new(config, dialogue)
}
