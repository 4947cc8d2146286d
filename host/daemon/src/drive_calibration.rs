//! What the drives say about the calibration, for status and log.

use singletrack_api::Calibration;
use singletrack_core::{
    Config,
    online_calibration::{OnlineCalibration, advice},
};
use singletrack_pilot::Learned;
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

    /// Takes a tick of a drive; gives what the pilot is to be told.
    pub(crate) fn tick(&mut self, tick: &TickRecord) -> Option<Learned> {
        let (_, estimator) = self.estimator.as_mut()?;
        self.ticks += 1;
        estimator.tick(tick)
    }

    /// Once a second of a drive, what is known by then.
    pub(crate) fn news(&self) -> Option<(u32, Calibration)> {
        (self.ticks % INTERVAL == 1).then(|| self.known())?
    }

    /// The drive has ended: what is known, with the number of the configuration.
    pub(crate) fn end(&mut self) -> Option<(u32, Calibration)> {
        (core::mem::take(&mut self.ticks) > 0).then(|| self.known())?
    }

    fn known(&self) -> Option<(u32, Calibration)> {
        let (config, estimator) = self.estimator.as_ref()?;
        let mut known = advice(config, &estimator.estimates());
        if let Some(change) = estimator.steering_change() {
            known.advice.push(format!(
                "the steering has changed while the car drove, as by {change:.3} rad of trim: look \
                 at the servo's horn"
            ));
        }
        Some((self.number?, known))
    }
}
