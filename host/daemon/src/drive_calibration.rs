//! What the drives say about the calibration, for the log.

use singletrack_core::{
    Config,
    online_calibration::{OnlineCalibration, advice},
};
use singletrack_record::TickRecord;

/// Estimates over the drives with a configuration.
#[derive(Debug, Default)]
pub(crate) struct DriveCalibration {
    /// The number of the configuration.
    number: Option<u32>,
    estimator: Option<(Config, OnlineCalibration)>,
    drove: bool,
}

impl DriveCalibration {
    /// A drive begins, with the configuration of this number and text. Another configuration
    /// discards what was collected.
    pub(crate) fn begin(&mut self, number: u32, toml: Option<&str>) {
        if self.number == Some(number) {
            return;
        }
        self.number = Some(number);
        self.estimator = toml
            .and_then(|text| Config::from_toml(text).ok())
            .and_then(|config| OnlineCalibration::new(&config).map(|it| (config, it)));
    }

    /// Takes a tick of a drive.
    pub(crate) fn tick(&mut self, tick: &TickRecord) {
        if let Some((_, estimator)) = &mut self.estimator {
            self.drove = true;
            estimator.tick(tick);
        }
    }

    /// The drive has ended: what is wrong with the calibration, if anything is known.
    pub(crate) fn end(&mut self) -> Vec<String> {
        match &self.estimator {
            Some((config, estimator)) if core::mem::take(&mut self.drove) => {
                advice(config, &estimator.estimates())
            }
            _ => Vec::new(),
        }
    }
}
