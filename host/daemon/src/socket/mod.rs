//! The control socket: one JSON object per line, in both directions, as the crate
//! `singletrack-api` has them. The page `docs/control-socket.md` describes the protocol.
//!
//! With `socket.tcp_port` the same is served on that port of 127.0.0.1 too. There the first line
//! gives the token, which is in the file `<socket.path>.token`, new at every start. A connection
//! that begins with anything else is answered once, and closed.
//!
//! A client that sends invalid set-points without reading the answers is not read any more once
//! the answers fill its connection.

mod answers;
mod arm;
mod attend;
mod bind;
mod command;
mod drives;
mod serve;
mod setpoint;
mod stream;
#[cfg(test)]
mod tests;

pub(crate) use bind::BoundSocket;
pub use command::{Arm, Attendance, Command, ParseError};
pub(crate) use drives::Drives;
pub(crate) use serve::SocketThread;
pub(crate) use setpoint::Newest;
pub use setpoint::SetpointFigures;
