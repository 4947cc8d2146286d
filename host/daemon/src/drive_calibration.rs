//! What the drives say about the calibration, for status and log.

use singletrack_api::Calibration;
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
    /// Ticks of the drive under way.
    ticks: u32,
}

/// Interval at which the estimates are computed, in ticks.
const INTERVAL: u32 = 100;

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

    /// Takes a tick of a drive; once a second, gives what is known by then.
    pub(crate) fn tick(&mut self, tick: &TickRecord) -> Option<(u32, Calibration)> {
        let (_, estimator) = self.estimator.as_mut()?;
        estimator.tick(tick);
        self.ticks += 1;
        self.ticks.is_multiple_of(INTERVAL).then(|| self.known())?
    }

    /// The drive has ended: what is known, with the number of the configuration.
    pub(crate) fn end(&mut self) -> Option<(u32, Calibration)> {
        (core::mem::take(&mut self.ticks) > 0).then(|| self.known())?
    }

    fn known(&self) -> Option<(u32, Calibration)> {
        let (config, estimator) = self.estimator.as_ref()?;
        Some((self.number?, advice(config, &estimator.estimates())))
    }
}
