//! The limits of plausible sensors and of tick timing.

/// The limits of plausible sensors and of tick timing, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchConfig {
    /// The largest plausible yaw rate, rad/s.
    pub max_yaw_rate: f64,
    /// The largest plausible acceleration, m/s².
    pub max_acceleration: f64,
    /// The largest plausible gyro bias, rad/s.
    pub max_gyro_bias: f64,
    /// The number of samples in a row out of range that make the IMU implausible.
    pub implausible_samples: u32,
    /// The number of repetitions of one sample that make the IMU stuck; 0 disables the
    /// check.
    pub stuck_samples: u32,
    /// Speeds from motor and cameras may differ by this, m/s...
    pub speed_margin: f64,
    /// ...plus this fraction of the larger one.
    pub speed_ratio: f64,
    /// The car may exceed its speed limit by this, m/s.
    pub overspeed_margin: f64,
    /// The longest time between two ticks, s.
    pub max_gap: f64,
    /// The number of ticks that may be missed in a second.
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
