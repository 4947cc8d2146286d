//! `[online_calibration]`: what a drive says about the calibration.

use singletrack_settings::{Declared as _, section};
use singletrack_words::words;

use super::{Config, ConfigError};

words! {
    /// What becomes of the estimates.
    pub enum OnlineCalibrationMode: serde {
        /// Nothing is estimated.
        Off = "off",
        /// The estimates are shown.
        Advice = "advice",
        /// The controller corrects what it acts on by them, too.
        Live = "live",
    }
}

section! {
    /// Estimates how steering, cameras, IMU and motor sensor differ from their configuration, while
    /// the car drives. `docs/online-calibration.md` says what the estimates are worth.
    "online_calibration" => pub OnlineCalibrationSection: Copy;
    [default];

    /// "off"; "advice": status and log say what is off; or "live": the controller corrects what it
    /// acts on, within bounds, and begins every drive without a correction. "live" excludes the
    /// safety filter.
    mode: OnlineCalibrationMode = OnlineCalibrationMode::Off, text "\"off\", \"advice\" or \"live\"";
}

impl OnlineCalibrationSection {
    /// Refuses live calibration with the safety filter, which rests on the configured steering.
    pub(super) fn validate(self, config: &Config) -> Result<(), ConfigError> {
        if self.mode == OnlineCalibrationMode::Live && config.safety_filter.enabled {
            return Err(ConfigError::value(
                "online_calibration.mode",
                "\"live\"",
                "the safety filter rests on the configured steering; use \"advice\", or set \
                 safety_filter.enabled = false",
            ));
        }
        Ok(self.check()?)
    }

    /// Whether anything is estimated.
    #[must_use]
    pub fn is_enabled(self) -> bool {
        self.mode != OnlineCalibrationMode::Off
    }
}
