//! The live view: the messages of the record, as they are made, for Foxglove,
//! Lichtblick and PlotJuggler.
//!
//! The server only publishes: there is no authentication, so a client can subscribe and
//! nothing else. Commands go through the control socket.
//!
//! The server has its own thread and its own ring; viewers cannot delay the other
//! threads. For a slow viewer the kernel queues up to some MB, and then messages are
//! dropped. Connections are not limited: a client that reaches the port can open as many
//! as the process may have files.

#[cfg(not(feature = "live"))]
mod not_built;
#[cfg(feature = "live")]
mod server;
mod status;

#[cfg(not(feature = "live"))]
pub(crate) use not_built::LiveThread;
#[cfg(feature = "live")]
pub(crate) use server::LiveThread;
pub(crate) use status::LiveView;
pub use status::{LiveError, LiveStatus};
