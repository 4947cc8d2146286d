//! The NatNet wire format: bytes to values.
//!
//! Every decoder is strict: it reads within the bounds of the datagram, checks every
//! declared size against the bytes consumed, and accepts a packet only when no byte is
//! left. Nothing is copied or allocated: decoded values borrow the datagram. Start with
//! [`ServerMessage::decode`]; the opposite direction is in [`crate::encode`].

mod client;
mod error;
mod frame;
mod model;
mod packet;
mod reader;
mod rigid_body;
mod server;
mod server_info;
mod version;

pub use client::{ClientMessage, Connect, bitstream_request};
pub use error::DecodeError;
pub use frame::{CameraTicks, Frame, FrameFlags, PrecisionTime, SectionCounts};
pub use model::{ModelDefinitions, RigidBodyDefinition, RigidBodyDefinitions};
pub use packet::{HEADER_LEN, MAX_DATAGRAM_LEN, MessageId, Packet};
pub use rigid_body::{RigidBodies, RigidBody};
pub use server::{Echo, Response, ServerMessage};
pub use server_info::{Connection, DataChannel, SENDER_LEN, ServerInfo};
pub use version::{BitstreamVersion, UnsupportedVersion};

pub(crate) use model::dataset;
pub(crate) use server_info::SENDER_NAME_LEN;
