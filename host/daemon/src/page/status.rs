//! Errors of the page.

use std::{io, net::SocketAddr, path::PathBuf};

/// Why the page is not served.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// Another program listens on the address, or listening is not permitted.
    #[error(
        "can't listen on {address} for the page: {source}; choose another page.address or \
         page.port, or set page.enabled = false"
    )]
    Listen {
        /// The configured address.
        address: SocketAddr,
        /// The system's error.
        source: io::Error,
    },
    /// The file of the token can't be written.
    #[error(
        "can't write the token of the page to {}: {source}; choose a page.token_file in a folder \
         that you may write to",
        path.display()
    )]
    Token {
        /// The configured path.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The thread of the server does not start.
    #[error("the page's server does not start: {0}; or set page.enabled = false")]
    Server(io::Error),
    /// The program was built without the feature `page`.
    #[error(
        "this singletrackd was built without the page: set page.enabled = false, or build it with \
         the feature `page`"
    )]
    NotBuilt,
}
