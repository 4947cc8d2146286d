//! The real board code drives the simulated car.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod scenarios;

/// Compiled for this machine.
const KIND: singletrack_sim::BoardKind = singletrack_sim::BoardKind::Native;
