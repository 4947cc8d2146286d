//! What the drives say about the calibration, for status and log; and the noise of the IMU in a
//! drive, against what `[estimator]` believes.
//!
//! The second differences of successive samples hold their noise and nearly nothing of the car's
//! motion. Noise that is not white is measured as if it were, which is enough for a warning.

use std::sync::Arc;

use singletrack_api::Calibration;
use singletrack_core::{
    Config,
    config::{EstimatorSection, OnlineCalibrationMode},
    online_calibration::{OnlineCalibration, advice},
};
use singletrack_pilot::Learned;
use singletrack_record::{TelemetryRecord, TickRecord};

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

/// Measured over believed density from which a drive ends with a warning.
const TOO_NOISY: f64 = 3.0;
/// Least number of second differences: two seconds at 100 Hz.
const MIN_SAMPLES: u32 = 200;
/// The most that one sample counts, as a multiple of the believed power: some samples are torn.
const MOST: f64 = 100.0;
/// The longest time between samples, s.
const GAP_S: f64 = 0.05;

/// A sample: time in ns, acceleration forward and left in m/s², yaw rate in rad/s.
#[derive(Clone, Copy, Debug)]
struct Sample {
    time_ns: u64,
    values: [f64; 3],
}

/// Collects the noise of a drive.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct DriveNoise {
    last: [Option<Sample>; 2],
    /// Powers of accelerometer and gyro over the believed ones.
    sums: [f64; 2],
    count: u32,
}

impl DriveNoise {
    /// A record of the telemetry of a car that drives.
    pub(crate) fn telemetry(&mut self, record: &TelemetryRecord, believed: &EstimatorSection) {
        let Some(time_ns) = record.new_imu_time_ns() else {
            return;
        };
        let [forward, left, _] = record.linear_acceleration_m_s2();
        let [_, _, yaw_rate] = record.angular_velocity_rad_s();
        let speed = f64::from(record.telemetry.motor_speed_mm_s) * 1e-3;
        let sample = Sample {
            time_ns,
            values: [forward, left, yaw_rate],
        };
        self.sample(sample, speed, believed);
    }

    fn sample(&mut self, sample: Sample, speed: f64, believed: &EstimatorSection) {
        let [before, last] = self.last;
        self.last = [last, Some(sample)];
        let (Some(before), Some(last)) = (before, last) else {
            return;
        };
        let seconds =
            |from: Sample, to: Sample| to.time_ns.saturating_sub(from.time_ns) as f64 * 1e-9;
        let (first, second) = (seconds(before, last), seconds(last, sample));
        let period = f64::midpoint(first, second);
        if period <= 0.0 || first.max(second) > GAP_S || (first - second).abs() > 0.5 * period {
            return;
        }
        // The variance of a second difference of white noise is six times that of a sample.
        let power = |axis: usize| {
            let [a, b, c] = [before, last, sample].map(|sample| sample.values[axis]);
            (a - 2.0 * b + c).powi(2) / 6.0 * period
        };
        let rest = believed.acceleration_noise_density_m_s2_per_sqrt_hz;
        let vibration = believed.vibration_noise_density_m_s2_per_sqrt_hz_per_m_s * speed;
        let acceleration = f64::midpoint(power(0), power(1)) / (rest.powi(2) + vibration.powi(2));
        let turn = power(2) / believed.gyro_noise_density_rad_s_per_sqrt_hz.powi(2);
        self.sums[0] += acceleration.min(MOST);
        self.sums[1] += turn.min(MOST);
        self.count += 1;
    }

    /// Measured over believed density of accelerometer and gyro.
    fn factors(&self) -> Option<[f64; 2]> {
        let count = f64::from(self.count);
        (self.count >= MIN_SAMPLES).then(|| self.sums.map(|sum| (sum / count).sqrt()))
    }

    /// At the end of the drive: a warning if the IMU was much noisier than believed.
    pub(crate) fn end(&mut self) -> Option<String> {
        let [acceleration, turn] = core::mem::take(self).factors()?;
        (acceleration > TOO_NOISY || turn > TOO_NOISY).then(|| {
            format!(
                "in this drive the accelerometer was {acceleration:.1} and the gyro {turn:.1} times \
                 as noisy as [estimator] believes: speed and sideslip may be wrong; measure the \
                 noise with `singletrack doctor --stand`, or compare `noise` of `singletrack judge`"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use core::f64::consts::TAU;

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
        // That drive slows down.
        drives.begin(2, &config);
        assert_eq!(drives.in_force, Some(Learned::MOST));
        drives.end();
        assert_eq!(drives.in_force, None);
        drives.begin(2, &config);
        assert_eq!(drives.in_force, Some(Learned::default()));
    }

    fn estimator() -> EstimatorSection {
        let text = include_str!("../singletrackd.example.toml");
        Config::from_toml(text).unwrap().estimator
    }

    /// Ten seconds at 1 m/s with this deviation of acceleration and yaw rate, on top of a motion
    /// at 0.5 Hz of 3 m/s² and 1.5 rad/s.
    fn drive(acceleration: f64, turn: f64) -> DriveNoise {
        let estimator = estimator();
        let mut noise = DriveNoise::default();
        let mut random = singletrack_control::statistics::Random::new(1);
        let mut random = || random.normal(1.0);
        for index in 0..1_000_u64 {
            let motion = (TAU * 0.005 * index as f64).sin();
            let sample = Sample {
                time_ns: index * 10_000_000,
                values: [
                    3.0 * motion + acceleration * random(),
                    3.0 * motion + acceleration * random(),
                    1.5 * motion + turn * random(),
                ],
            };
            noise.sample(sample, 1.0, &estimator);
        }
        noise
    }

    #[test]
    fn an_imu_as_noisy_as_believed_is_no_warning() {
        // Believed: 1.1 m/s² and 0.05 rad/s a sample.
        for (acceleration, turn) in [(0.0, 0.0), (1.1, 0.05), (2.5, 0.12)] {
            assert_eq!(drive(acceleration, turn).end(), None, "{acceleration}");
        }
    }

    #[test]
    fn an_imu_that_is_four_times_as_noisy_is_named_with_the_factors() {
        // Believed: 1.1 m/s² and 0.05 rad/s a sample.
        let mut noise = drive(4.47, 0.1);
        let [acceleration, turn] = noise.factors().unwrap();
        assert!((acceleration - 4.0).abs() < 0.3, "{acceleration}");
        assert!((turn - 2.0).abs() < 0.2, "{turn}");
        let text = noise.end().unwrap();
        let named = format!("accelerometer was {acceleration:.1} and the gyro {turn:.1} times");
        assert!(text.contains(&named), "{text}");
        // Nothing of it is left for the next drive.
        assert_eq!(noise.end(), None);
        assert!(drive(0.1, 0.2).end().is_some());
    }

    #[test]
    fn a_short_drive_torn_samples_and_gaps_say_nothing() {
        let estimator = estimator();
        let mut noise = drive(9.0, 1.0);
        noise.count = MIN_SAMPLES - 1;
        assert_eq!(noise.end(), None);
        let mut noise = DriveNoise::default();
        for index in 0..1_000_u64 {
            let value = if index % 100 == 0 { 300.0 } else { 0.0 };
            let sample = Sample {
                time_ns: index * 10_000_000,
                values: [value; 3],
            };
            noise.sample(sample, 1.0, &estimator);
        }
        assert_eq!(noise.end(), None);
        let mut noise = DriveNoise::default();
        for index in 0..1_000_u64 {
            let sample = Sample {
                time_ns: index * 100_000_000,
                values: [(index % 2) as f64 * 100.0; 3],
            };
            noise.sample(sample, 1.0, &estimator);
        }
        assert_eq!(noise.end(), None);
    }
}
