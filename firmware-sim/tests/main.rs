//! The simulator in virtual time, and its sockets.

mod determinism;
mod hands;
mod hostile_input;
mod natnet_server;
mod other_cars;
mod physics;
