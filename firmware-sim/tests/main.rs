//! The simulator in virtual time, and its sockets.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]

mod hands;
mod natnet_server;
mod other_cars;
mod physics;
mod world;
