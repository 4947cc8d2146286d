//! The page for a browser, over HTTP.
//!
//! | path | content |
//! |---|---|
//! | `/` and its `.js`, `.css`, `.svg` | the page, which needs nothing from elsewhere |
//! | `/setup.json` | what does not change during a drive: geofence, path of the reference, name and size of the car, and the words of [`singletrack_core::reasons`] |
//! | `/history.json` | of the states of the last 20 s what charts and trail show; it is kept for 5 s without a viewer |
//! | `/events` | Server-Sent Events: `state`, the newest line of the state stream 25 times a second; `status`, that of the control socket once a second; and `lost`, why there is no daemon |
//!
//! It only shows: anything but GET and HEAD is refused. Beyond loopback, and wherever
//! `page.token_file` is set, the last three paths take the token. Without a token, a request must
//! name this computer by a number or as `localhost`: a web page elsewhere that gives its own
//! name this address learns nothing.
//!
//! A viewer that is slow to read gets fewer states, always the newest, and delays no other. A
//! connection that sends no whole request, or does not read its answer, gives way to newer ones.

mod feed;
mod respond;
mod server;

pub use feed::OtherCar;
pub use respond::{BadRequest, Request};
pub use server::Page;
