//! The daemon's own page for a browser, over HTTP.
//!
//! | path | content |
//! |---|---|
//! | `/` and its `.js`, `.css`, `.svg` | the page, which needs nothing from elsewhere |
//! | `/setup.json` | what does not change during a drive: geofence, path of the reference, size of the car, and the words of [`singletrack_core::reasons`] |
//! | `/events` | Server-Sent Events: `state`, the newest line of the state stream 25 times a second, and `status`, that of the control socket once a second |
//!
//! It only shows: anything but GET and HEAD is refused. Beyond loopback, and wherever
//! `page.token_file` is set, the last two paths take the token. Without a token, a request must
//! name this computer by a number or as `localhost`: a web page elsewhere that gives its own
//! name this address learns nothing.
//!
//! The server has its own thread. A viewer that is slow to read gets fewer states, always the
//! newest, and delays nothing.

#[cfg(feature = "page")]
mod assets;
#[cfg(feature = "page")]
mod feed;
#[cfg(not(feature = "page"))]
mod not_built;
#[cfg(feature = "page")]
mod request;
#[cfg(feature = "page")]
mod respond;
#[cfg(feature = "page")]
mod server;
#[cfg(feature = "page")]
mod setup;
mod status;

#[cfg(not(feature = "page"))]
pub(crate) use not_built::{BoundPage, PageThread};
#[cfg(feature = "page")]
pub use request::{BadRequest, Request};
#[cfg(feature = "page")]
pub(crate) use server::{BoundPage, PageThread};
pub use status::PageError;
