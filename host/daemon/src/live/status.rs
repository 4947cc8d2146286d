//! State and errors of the live view.

use std::{
    io,
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

/// Why the live view does not start.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// Another program listens on the address, or listening is not permitted.
    #[error(
        "can't listen on {address} for the live view: {source}; choose another live.address or \
         live.port, or set live.enabled = false"
    )]
    Listen {
        /// The configured address.
        address: SocketAddr,
        /// The system's error.
        source: io::Error,
    },
    /// The server or its thread does not start.
    #[error("the live view does not start: {0}; or set live.enabled = false")]
    Server(String),
    /// The program was built without the feature `live`.
    #[error(
        "this singletrackd was built without the live view: set live.enabled = false, or build \
         it with the feature `live`"
    )]
    NotBuilt,
}

/// A server for viewers, the live view or the page, for the status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LiveStatus {
    /// The address that it listens on, with the port in use.
    pub address: SocketAddr,
    /// The number of connected viewers.
    pub viewers: u64,
}

impl LiveStatus {
    /// As the control socket gives it.
    pub(crate) fn server(self) -> singletrack_api::Server {
        singletrack_api::Server {
            address: self.address.to_string(),
            viewers: self.viewers,
        }
    }
}

/// The state of a server's thread, shared with the others.
#[derive(Clone, Debug)]
pub(crate) struct LiveView {
    pub(super) address: SocketAddr,
    pub(super) viewers: Arc<AtomicU64>,
}

impl LiveView {
    #[cfg(feature = "page")]
    pub(crate) fn new(address: SocketAddr) -> Self {
        Self {
            address,
            viewers: Arc::default(),
        }
    }

    #[cfg(feature = "page")]
    pub(crate) const fn address(&self) -> SocketAddr {
        self.address
    }

    /// To count them.
    #[cfg(feature = "page")]
    pub(crate) fn viewers(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.viewers)
    }

    pub(crate) fn status(&self) -> LiveStatus {
        LiveStatus {
            address: self.address,
            viewers: self.viewers.load(Ordering::Relaxed),
        }
    }
}
