//! The live view: the messages of the record, as they are made, for Foxglove,
//! Lichtblick and PlotJuggler.
//!
//! The server only publishes: there is no authentication, so a client can subscribe and
//! nothing else. Commands go through the control socket.
//!
//! The server has its own thread and its own ring; viewers cannot delay the other
//! threads. For a slow viewer a bounded number of messages waits, and then messages are
//! dropped. At most eight viewers are connected; others are turned away, and so is a
//! client that connects and says nothing.

#[cfg(not(feature = "live"))]
mod not_built;
#[cfg(feature = "live")]
mod relay;
#[cfg(feature = "live")]
mod server;
mod status;

#[cfg(not(feature = "live"))]
pub(crate) use not_built::LiveThread;
#[cfg(feature = "live")]
pub(crate) use server::LiveThread;
pub(crate) use status::LiveView;
pub use status::{LiveError, LiveStatus};
