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

mod bits;
mod bodies;
mod clock;
mod contradictions;
mod deadlines;
mod handshake;
mod models;
mod poses;
mod stream;
mod world;
