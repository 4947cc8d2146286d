//! The session with the board in virtual time.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

mod clock;
mod common;
mod deadlines;
mod end_to_end;
mod handshake;
mod requests;
