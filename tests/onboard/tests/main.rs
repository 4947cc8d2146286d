//! The onboarding of simulated cars.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]

mod bring_up;
mod campaign;
mod doctor;
mod imu_noise;
mod killed;
