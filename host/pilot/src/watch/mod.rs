//! Plausibility of the sensors, and tick timing.
//!
//! One monitor per kind of failure. A monitor is fed with samples or ticks and then
//! queried; it decides nothing. The supervisor turns its verdict into a reason.

mod blind;
mod config;
mod imu;
mod speed;
mod ticks;

pub(crate) use blind::BlindWatch;
pub use config::WatchConfig;
pub use imu::ImuVerdict;
pub(crate) use imu::ImuWatch;
pub(crate) use speed::SpeedWatch;
pub(crate) use ticks::TickWatch;
