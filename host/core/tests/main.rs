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

mod board_section;
mod config;
mod config_documents;
mod config_effects;
mod config_mistakes;
mod control_loop;
mod diagnosis;
mod documented_sections;
mod feasibility;
mod outer_loops;
mod reasons;
mod safety_filter;
#[path = "common/simulated_drive.rs"]
mod simulated_drive;
mod stamps;
mod tuning;
