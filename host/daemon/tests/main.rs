//! The daemon.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

mod check;
mod common;
mod control_port;
mod control_socket;
mod documentation;
mod files;
mod hazards;
mod packaging;
mod references;
mod serial_line;
mod service;
#[path = "common/terminal.rs"]
mod terminal;
mod tuning;
