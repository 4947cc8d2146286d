//! The onboarding of simulated cars.

mod bring_up;
mod campaign;
mod doctor;
mod imu_noise;
mod killed;
