//! The real-time protocol of Qualisys Track Manager (QTM): version 1.13 and later servers.
//!
//! - [`Session`] is a client of one server, over TCP, with frames in datagrams or on TCP, in
//!   either byte order.
//! - [`packet`] turns bytes into packets, and packets into bytes, for both sides.
//!
//! QTM names its bodies in XML ([`BodyList`]) and sends them in that order, in millimetres, with
//! a rotation matrix; a body that is not seen is not a number.

pub mod packet;

pub(crate) mod body_list;
mod dialogue;

pub use body_list::BodyList;
pub use dialogue::QualisysDialogue;

use crate::{config::SessionConfig, stream::StreamSession};

/// A client of a QTM server, without I/O.
pub type Session = StreamSession<QualisysDialogue>;

pub(crate) fn session(config: SessionConfig) -> Session {
    StreamSession::new(config, QualisysDialogue::default())
}
