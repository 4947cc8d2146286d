//! Configuration and control loop.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

mod certificate;
mod config;
mod config_mistakes;
mod control_loop;
mod diagnosis;
mod documents;
mod feasibility;
mod governed_feasibility;
mod outer_loops;
mod reasons;
#[path = "common/simulated_drive.rs"]
mod simulated_drive;
mod tuning;
