//! Scenarios and the virtual host.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]

#[path = "common/calibrated.rs"]
mod calibrated;
mod calibrated_cars;
mod car_plant;
#[path = "common/estimation.rs"]
mod estimation;
mod fence;
mod first_metre;
mod fleet;
mod foreign;
mod frames_begin_ticks;
mod governor;
mod host_first;
mod ideal_plant;
mod jog;
mod online_calibration;
mod other_cars;
mod proofs;
mod pulse_distance;
mod rare_poses;
mod scenario_page;
mod start;
mod tracking;
mod tuning;
