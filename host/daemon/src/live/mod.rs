//! The live view: the messages of the record, as they are made, for Foxglove,
//! Lichtblick and PlotJuggler.
//!
//! It only publishes: a client can subscribe and nothing else, since there is no
//! authentication. Commands go through the control socket. It has a thread of its
//! own and a ring of its own, so that neither viewers nor the want of them hold up the
//! others. A viewer that is too slow is shown what the kernel has queued for it, up to
//! some MB, and misses messages after that. Connections are not counted: a client that
//! reaches the port can open as many as the process may have files.

#[cfg(feature = "live")]
mod server;

use std::{
    io,
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use serde::Serialize;

#[cfg(feature = "live")]
pub(crate) use server::LiveThread;

/// Why there is no live view.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// Another program listens there, or listening is not permitted.
    #[error(
        "can't listen on {address} for the live view: {source}; choose another live.address or \
         live.port, or set live.enabled = false"
    )]
    Listen {
        /// Where.
        address: SocketAddr,
        /// What the system says.
        source: io::Error,
    },
    /// The server does not start.
    #[error("the live view does not start: {0}; or set live.enabled = false")]
    Server(String),
    /// This program was built without it.
    #[error(
        "this singletrackd was built without the live view: set live.enabled = false, or build \
         it with the feature `live`"
    )]
    NotBuilt,
}

/// How the live view is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct LiveStatus {
    /// Where it listens.
    pub address: SocketAddr,
    /// How many watch.
    pub viewers: u64,
}

/// What others may look at.
#[derive(Clone, Debug)]
pub(crate) struct LiveView {
    address: SocketAddr,
    viewers: Arc<AtomicU64>,
}

impl LiveView {
    pub(crate) fn status(&self) -> LiveStatus {
        LiveStatus {
            address: self.address,
            viewers: self.viewers.load(Ordering::Relaxed),
        }
    }
}

/// Stands for the server's thread where there is none.
#[cfg(not(feature = "live"))]
#[derive(Debug)]
pub(crate) struct LiveThread {
    pub(crate) view: LiveView,
}

#[cfg(not(feature = "live"))]
impl LiveThread {
    pub(crate) fn start(
        _: singletrack_core::config::LiveSection,
        _: singletrack_record::ClockMapping,
    ) -> Result<(Self, singletrack_record::FeedInput), LiveError> {
        Err(LiveError::NotBuilt)
    }
}
