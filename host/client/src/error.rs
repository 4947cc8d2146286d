//! Why the daemon could not be asked, or refused.

use std::{io, path::PathBuf};

/// Why a request failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// No process listens at the socket.
    #[error(
        "can't reach the daemon at {}: {source}; is singletrackd running, with this socket.path?",
        path.display()
    )]
    Connect {
        /// The socket.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The connection failed.
    #[error("lost the connection to the daemon: {0}")]
    BrokeOff(#[from] io::Error),
    /// The answer can't be read.
    #[error("can't understand the daemon's answer: {0}; is it the same version as this program?")]
    Answer(#[from] serde_json::Error),
    /// The daemon refuses.
    #[error("{0}")]
    Refused(String),
}
