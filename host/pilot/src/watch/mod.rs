//! Plausibility of the sensors, and tick timing.
//!
//! One monitor per kind of failure. A monitor is fed with samples or ticks and then
//! queried; it decides nothing. The supervisor turns its verdict into a reason.

mod attitude;
mod blind;
mod config;
mod consistency;
mod gyro;
mod imu;
mod proving;
mod roll_out;
mod slide;
mod speed;
mod start;
mod steps;
mod stop;
mod ticks;

pub(crate) use attitude::{AttitudeWatch, PushWatch};
pub(crate) use blind::BlindWatch;
pub use config::WatchConfig;
pub(crate) use consistency::{FrozenWatch, InnovationWatch, SideslipWatch, SteeringWatch};
pub(crate) use gyro::GyroWatch;
pub use imu::ImuVerdict;
pub(crate) use imu::ImuWatch;
pub(crate) use proving::{PROVING_SPEED, Proving, WAVE};
pub(crate) use slide::SlideWatch;
pub(crate) use speed::SpeedWatch;
pub(crate) use start::StartWatch;
pub(crate) use steps::Steps;
pub(crate) use stop::{Speeds, StopLimits, StopWatch};
pub(crate) use ticks::TickWatch;

/// Counts repetitions; restarts from zero.
pub(crate) const fn count(counter: &mut u32, again: bool) {
    *counter = if again { counter.saturating_add(1) } else { 0 };
}
