//! The session with the board in virtual time.

mod clock;
mod common;
mod deadlines;
mod end_to_end;
mod handshake;
mod requests;
