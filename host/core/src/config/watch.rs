//! `[watch]`: what the senses may say, and how punctual a tick must be.

use serde::{Deserialize, Serialize};
use singletrack_pilot::WatchConfig;

use super::{ConfigError, check};

/// What the senses may say, and how punctual a tick must be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WatchSection {
    /// No yaw rate above this can be.
    pub max_yaw_rate_rad_s: f64,
    /// No acceleration above this can be.
    pub max_acceleration_m_s2: f64,
    /// No gyro bias above this can be.
    pub max_gyro_bias_rad_s: f64,
    /// So many inertial samples in a row that can't be stop the car.
    pub implausible_samples: u32,
    /// So many equal inertial samples in a row stop the car; 0 does not look.
    pub stuck_samples: u32,
    /// Motor and cameras may tell speeds this far apart...
    pub speed_margin_m_s: f64,
    /// ...and this part of the larger one.
    pub speed_ratio: f64,
    /// The car may be this much faster than `limits.max_speed_m_s`.
    pub overspeed_margin_m_s: f64,
    /// A tick this long after the one before stops the car.
    pub max_gap_ms: u32,
    /// More ticks than this missed in a second stop the car.
    pub max_missed_ticks_per_s: u32,
}

impl Default for WatchSection {
    fn default() -> Self {
        let config = WatchConfig::paper();
        Self {
            max_yaw_rate_rad_s: config.max_yaw_rate,
            max_acceleration_m_s2: config.max_acceleration,
            max_gyro_bias_rad_s: config.max_gyro_bias,
            implausible_samples: config.implausible_samples,
            stuck_samples: config.stuck_samples,
            speed_margin_m_s: config.speed_margin,
            speed_ratio: config.speed_ratio,
            overspeed_margin_m_s: config.overspeed_margin,
            // A fraction of a second.
            max_gap_ms: (config.max_gap * 1_000.0).round() as u32,
            max_missed_ticks_per_s: config.max_missed,
        }
    }
}

impl WatchSection {
    /// For the controller.
    #[must_use]
    pub fn config(&self) -> WatchConfig {
        WatchConfig {
            max_yaw_rate: self.max_yaw_rate_rad_s,
            max_acceleration: self.max_acceleration_m_s2,
            max_gyro_bias: self.max_gyro_bias_rad_s,
            implausible_samples: self.implausible_samples,
            stuck_samples: self.stuck_samples,
            speed_margin: self.speed_margin_m_s,
            speed_ratio: self.speed_ratio,
            overspeed_margin: self.overspeed_margin_m_s,
            max_gap: check::seconds(self.max_gap_ms),
            max_missed: self.max_missed_ticks_per_s,
        }
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        for (key, value, highest) in [
            ("watch.max_yaw_rate_rad_s", self.max_yaw_rate_rad_s, 35.0),
            (
                "watch.max_acceleration_m_s2",
                self.max_acceleration_m_s2,
                160.0,
            ),
            ("watch.max_gyro_bias_rad_s", self.max_gyro_bias_rad_s, 1.0),
            ("watch.speed_margin_m_s", self.speed_margin_m_s, 2.0),
            ("watch.speed_ratio", self.speed_ratio, 0.9),
            ("watch.overspeed_margin_m_s", self.overspeed_margin_m_s, 5.0),
        ] {
            check::positive(key, value, highest)?;
        }
        check::within(
            "watch.implausible_samples",
            self.implausible_samples,
            1..=100,
        )?;
        check::within("watch.stuck_samples", self.stuck_samples, 0..=1_000)?;
        check::within("watch.max_gap_ms", self.max_gap_ms, 20..=95)?;
        check::within(
            "watch.max_missed_ticks_per_s",
            self.max_missed_ticks_per_s,
            1..=90,
        )
    }
}
