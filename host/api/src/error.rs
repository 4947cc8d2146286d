//! Why the daemon could not be asked, or refused.

use std::{
    io,
    path::{Path, PathBuf},
    time::Duration,
};

use crate::{Refused, RequestError};

/// Why a request failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// No process listens at the socket.
    #[error(
        "can't reach the daemon at {}: {source}; {}",
        path.display(),
        match source.kind() {
            io::ErrorKind::PermissionDenied => "add this user to the group of the socket, and log in again",
            _ => "start singletrackd, or correct socket.path or --socket",
        }
    )]
    Connect {
        /// The socket.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The daemon accepts no connection, or gives no answer.
    #[error(
        "no answer from the daemon at {} within {} s; is it stopped, or does its computer hang?",
        path.display(), patience.as_secs_f64()
    )]
    Silent {
        /// The socket.
        path: PathBuf,
        /// For how long it was waited.
        patience: Duration,
    },
    /// The daemon closed the connection.
    #[error(
        "lost the connection to the daemon: it has ended, or too many clients wait for it; look at \
         its log (journalctl -u singletrackd), start it if it does not run, and try again"
    )]
    Ended,
    /// The connection failed.
    #[error("lost the connection to the daemon: {0}")]
    BrokeOff(io::Error),
    /// The answer can't be read.
    #[error("can't understand the daemon's answer: {0}; is it the same version as this program?")]
    Answer(#[from] serde_json::Error),
    /// The line is none that answers.
    #[error("can't understand the daemon's line: {0}; is it the same version as this program?")]
    NoAnswer(String),
    /// The request can't be sent.
    #[error(transparent)]
    Request(#[from] RequestError),
    /// The daemon refuses.
    #[error(transparent)]
    Refused(#[from] Refused),
}

impl ClientError {
    /// The daemon at `path` has not answered within `patience`.
    pub fn silent(path: &Path, patience: Duration) -> Self {
        Self::Silent {
            path: path.to_owned(),
            patience,
        }
    }

    /// The error of a read that may take `patience`.
    #[cfg(unix)]
    pub(crate) fn of_read(error: io::Error, path: &Path, patience: Duration) -> Self {
        match error.kind() {
            io::ErrorKind::WouldBlock => Self::silent(path, patience),
            _ => error.into(),
        }
    }
}

impl From<io::Error> for ClientError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof
            | io::ErrorKind::BrokenPipe
            | io::ErrorKind::ConnectionReset => Self::Ended,
            _ => Self::BrokeOff(error),
        }
    }
}
