//! A client of the daemon's control socket: questions, connections that last, and the stream
//! of encoded messages.
//!
//! It blocks and starts no thread. The protocol is on the page `docs/control-socket.md`.

mod connection;
mod error;
mod messages;

pub use connection::{Connection, agreed, ask, connect};
pub use error::ClientError;
pub use messages::{Clocks, Message, MessageStream, Received};

/// The version of the protocol that this client speaks.
pub const SOCKET_VERSION: u32 = 2;
