//! The sessions in virtual time, against a scripted server.
#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "test helpers fail the test that calls them"
)]

mod bodies;
mod clock;
mod handshake;
mod poses;
mod stream;
mod world;
