//! Scenarios and the virtual host.

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

#[path = "common/calibrated.rs"]
mod calibrated;
mod digest;
#[path = "common/estimation.rs"]
mod estimation;
mod fence;
mod first_metre;
mod fleet;
mod foreign;
mod frames_begin_ticks;
mod jog;
mod online_calibration;
mod other_cars;
mod plants;
mod proofs;
mod scenario_page;
mod start;
mod tracking;
mod tuning;
mod watches;
