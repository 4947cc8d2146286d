//! `[online_calibration]`: what a drive says about the calibration.

use singletrack_settings::{Declared as _, section};
use singletrack_words::words;

use super::ConfigError;

words! {
    /// What becomes of the estimates.
    pub enum OnlineCalibrationMode: serde {
        /// Nothing is estimated.
        Off = "off",
        /// The estimates are shown.
        Advice = "advice",
        /// Refused: the controller does not use the estimates.
        Live = "live",
    }
}

section! {
    /// Estimates how steering, cameras, IMU and motor sensor differ from their configuration, while
    /// the car drives. The controller does not use the estimates. `docs/online-calibration.md` says
    /// what they are worth.
    "online_calibration" => pub OnlineCalibrationSection: Copy;
    [default];

    /// "off", or "advice": the estimates are shown.
    mode: OnlineCalibrationMode = OnlineCalibrationMode::Off, text "\"off\" or \"advice\"";
}

impl OnlineCalibrationSection {
    /// Refuses a mode that does not exist yet.
    pub(super) fn validate(self) -> Result<(), ConfigError> {
        if self.mode == OnlineCalibrationMode::Live {
            return Err(ConfigError::value(
                "online_calibration.mode",
                "\"live\"",
                "the controller can't use the estimates while the car drives; use \"advice\", and \
                 write them into the configuration",
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
