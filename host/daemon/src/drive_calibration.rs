//! What the drives say about the calibration, for status and log.

use std::sync::Arc;

use singletrack_api::Calibration;
use singletrack_core::{
    Config,
    config::OnlineCalibrationMode,
    online_calibration::{OnlineCalibration, advice},
};
use singletrack_pilot::Learned;
use singletrack_record::TickRecord;

/// Estimates over the drives with a configuration.
#[derive(Debug, Default)]
pub(crate) struct DriveCalibration {
    /// The number of the configuration.
    number: Option<u32>,
    estimator: Option<(Arc<Config>, OnlineCalibration)>,
    /// Ticks of the drive under way.
    ticks: u32,
    /// What the pilot corrects in the drive under way, if it learns.
    pub(crate) in_force: Option<Learned>,
}

/// Interval at which the estimates are computed, in ticks.
const INTERVAL: u32 = 100;

/// Interval at which the pilot is told what is learned, s.
const TOLD: f64 = 1.0;

impl DriveCalibration {
    /// A drive begins, with the configuration of this number. Another configuration discards what
    /// was collected.
    pub(crate) fn begin(&mut self, number: u32, config: &Arc<Config>) {
        if self.number != Some(number) {
            self.number = Some(number);
            self.estimator = OnlineCalibration::new(config).map(|it| (Arc::clone(config), it));
        }
        let config = self.estimator.as_ref().map(|(config, _)| config);
        let learns =
            config.is_some_and(|it| it.online_calibration.mode == OnlineCalibrationMode::Live);
        // Every drive begins as the configured car.
        self.in_force = learns.then(|| self.in_force.unwrap_or_default());
    }

    /// Takes a tick of a drive; gives what the pilot is to be told.
    pub(crate) fn tick(&mut self, tick: &TickRecord) -> Option<Learned> {
        let (_, estimator) = self.estimator.as_mut()?;
        self.ticks += 1;
        let learned = estimator.tick(tick)?;
        self.in_force = self.in_force.map(|it| it.towards(&learned, TOLD));
        Some(learned)
    }

    /// Once a second of a drive, what is known by then.
    pub(crate) fn news(&self) -> Option<(u32, Calibration)> {
        (self.ticks % INTERVAL == 1).then(|| self.known())?
    }

    /// The drive has ended: what is known, with the number of the configuration.
    pub(crate) fn end(&mut self) -> Option<(u32, Calibration)> {
        self.in_force = None;
        (core::mem::take(&mut self.ticks) > 0).then(|| self.known())?
    }

    fn known(&self) -> Option<(u32, Calibration)> {
        let (config, estimator) = self.estimator.as_ref()?;
        let mut known = advice(config, &estimator.errors.estimates());
        if let Some(change) = estimator.errors.steering_change {
            known.advice.push(format!(
                "the steering has changed while the car drove, as by {change:.3} rad of trim: look \
                 at the servo's horn"
            ));
        }
        Some((self.number?, known))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drive_that_learns_begins_without_a_correction() {
        let mut config = Config::from_toml(include_str!("../singletrackd.example.toml")).unwrap();
        let mut drives = DriveCalibration::default();
        drives.begin(1, &Arc::new(config.clone()));
        assert_eq!(drives.in_force, None);
        config.online_calibration.mode = OnlineCalibrationMode::Live;
        let config = Arc::new(config);
        drives.begin(2, &config);
        assert_eq!(drives.in_force, Some(Learned::default()));
        drives.in_force = Some(Learned::MOST);
        // The same drive slows down.
        drives.begin(2, &config);
        assert_eq!(drives.in_force, Some(Learned::MOST));
        drives.end();
        assert_eq!(drives.in_force, None);
        drives.begin(2, &config);
        assert_eq!(drives.in_force, Some(Learned::default()));
    }
}
