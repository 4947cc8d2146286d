//! Whether what the senses say can be, and whether time is kept: one watch for
//! each way to be wrong, each a small value that is told and asked.

mod blind;
mod imu;
mod speed;
mod ticks;

pub(crate) use blind::BlindWatch;
pub use imu::ImuVerdict;
pub(crate) use imu::ImuWatch;
pub(crate) use speed::SpeedWatch;
pub(crate) use ticks::TickWatch;

/// What the senses may say, and how punctual a tick must be, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchConfig {
    /// No yaw rate above this can be, rad/s.
    pub max_yaw_rate: f64,
    /// No acceleration above this can be, m/s².
    pub max_acceleration: f64,
    /// No gyro bias above this can be, rad/s.
    pub max_gyro_bias: f64,
    /// So many samples in a row that can't be, and the IMU is not believed.
    pub implausible_samples: u32,
    /// So many equal samples in a row, and the IMU hangs; 0 does not look.
    pub stuck_samples: u32,
    /// Motor and cameras may tell speeds this far apart, m/s...
    pub speed_margin: f64,
    /// ...and this part of the larger one.
    pub speed_ratio: f64,
    /// The car may be this much faster than its limit, m/s.
    pub overspeed_margin: f64,
    /// A tick this long after the one before stops the car, s.
    pub max_gap: f64,
    /// More ticks than this missed in a second stop the car.
    pub max_missed: u32,
}

impl WatchConfig {
    /// For the paper's car.
    #[must_use]
    pub const fn paper() -> Self {
        Self {
            max_yaw_rate: 10.0,
            max_acceleration: 35.0,
            max_gyro_bias: 0.2,
            implausible_samples: 5,
            stuck_samples: 25,
            speed_margin: 0.12,
            speed_ratio: 0.2,
            overspeed_margin: 0.4,
            max_gap: 0.08,
            max_missed: 20,
        }
    }
}
