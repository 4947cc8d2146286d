//! The live view: the messages of the record, as they are made, for Foxglove,
//! Lichtblick and PlotJuggler.
//!
//! The server only publishes: there is no authentication, so a client can subscribe and
//! nothing else. Commands go through the control socket.
//!
//! For a slow viewer a bounded number of messages waits, and then messages are dropped. At most
//! eight viewers are connected; others are turned away. A client that connects and sends no whole
//! request takes no place.

mod relay;
mod server;

pub use server::{Live, LiveError};
