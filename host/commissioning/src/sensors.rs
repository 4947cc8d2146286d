//! Each sensor of a drive beside what the cameras say of the same motion: whether it is mounted, scaled
//! and timed as it is taken to be.
//!
//! The cameras' motion is that of a parabola through the poses of a window. The sensors are smoothed by
//! what that does to a signal: its first derivative is the mean weighted by h² - t², its second the mean
//! weighted by (h² - t²)², h being half of the window. So a slope of one is one, whatever the window.

use nalgebra::SVector;
use serde::Serialize;
use singletrack_control::{InertialSample, Time};

use crate::{
    fit::left_out_deviation,
    seen::{Motion, Track},
};

/// The step of the comparison, s.
const STEP: f64 = 0.005;
/// The largest lag that is looked for, in steps: 200 ms.
const LAGS: isize = 40;
/// Parts of the drive, each of which is left out once: how much the results differ says how sure they
/// are.
const PARTS: usize = 10;
/// A difference is reported if it is this many of its standard deviations.
const SURE: f64 = 4.0;
/// Slopes nearer to one than this, and shorter lags (s), are not reported.
const SCALE: f64 = 0.05;
const LATE: f64 = 0.01;
/// An encoder counts over a while: its speed may be so late, s.
const COUNTS: f64 = 0.025;
/// A lag is reported if it lowers the unexplained variance by at least this factor.
const BETTER: f64 = 1.15;
/// A lag is reported if its standard deviation is below this, s, and the correlation above that.
const LAG_KNOWN: f64 = 0.01;
const AGREES: f64 = 0.5;
/// An axis of the accelerometer measures an acceleration if the slope is above the first, and above the
/// second times its standard deviation. The axes are swapped if that correlates by the third factor more.
const SEES: f64 = 0.3;
const FOUND: f64 = 4.5;
const CROSSED: f64 = 1.5;

/// A sensor beside the cameras.
#[derive(Clone, Debug, Serialize)]
pub struct Sensor {
    /// Which.
    pub sensor: &'static str,
    /// What it reads for each unit of what the cameras say, at the lag.
    pub slope: f64,
    /// Standard deviation of the slope.
    pub slope_deviation: f64,
    /// Its lateness against the cameras; negative for the steering, which the car follows.
    pub lag_s: f64,
    /// Standard deviation of the lag.
    pub lag_deviation_s: f64,
    /// Correlation of sensor and cameras at the lag.
    pub correlation: f64,
    /// Ratio of the variance that is unexplained without the lag to that with it.
    pub gain: f64,
}

/// What the sensors of a drive read, by the time of the measurement.
#[derive(Clone, Debug, Default)]
pub struct Readings {
    /// Samples of the IMU, NaN in what it does not measure.
    pub inertial: Vec<InertialSample>,
    /// Speed of the rear axle by the motor, m/s.
    pub motor: Vec<(Time, f64)>,
    /// Commanded steering angle, rad.
    pub steering: Vec<(Time, f64)>,
}

/// Where what is wrong is mended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// In the map by which another program's log was imported.
    Log,
    /// On a car of ours, and in its configuration.
    Car,
}

/// All sensors that can be compared, and what is wrong with them: which, what, and the fix.
pub fn compare(
    track: &Track,
    readings: &Readings,
    wheelbase: f64,
    source: Source,
) -> (Vec<Sensor>, Vec<String>) {
    let Some(grid) = Grid::of(track) else {
        return Default::default();
    };
    let inertial = |value: fn(&InertialSample) -> f64, power| {
        let samples = readings.inertial.iter();
        let values = samples.map(|sample| (sample.time, value(sample)));
        grid.smoothed(values.filter(|(_, value)| value.is_finite()), power)
    };
    let truth = |value: fn(&Motion) -> f64| grid.truth(value);
    let yaw_rate = truth(|motion| motion.yaw_rate);
    let mut sensors = Vec::new();
    let mut findings = Vec::new();
    let gyro = inertial(|sample| sample.yaw_rate, 1);
    let mut lag = 0.0;
    if let Some(sensor) = Sensor::of("gyro", &yaw_rate, &gyro) {
        if sensor.agrees() {
            lag = sensor.lag_s / STEP;
        }
        findings.extend(match source {
            Source::Log => sensor.finding("imu.yaw_rate", Some(("imu", LATE))),
            Source::Car => sensor.finding_of_car(Some(LATE), "steps imu-axes and latency"),
        });
        sensors.push(sensor);
    }
    let read = [
        inertial(|sample| sample.forward_acceleration, 2),
        inertial(|sample| sample.left_acceleration, 2),
    ];
    let moved = [0, 1].map(|axis| grid.truth(|motion| motion.acceleration[axis]));
    let mounting = Mounting::of(&moved, &read, lag);
    let turned = mounting.finding();
    let keys = ["imu.forward_acceleration", "imu.left_acceleration"];
    for (sensor, key) in mounting.axes.into_iter().zip(keys) {
        let Some(sensor) = sensor else { continue };
        // The fusion of our chip takes a lasting acceleration for gravity.
        if turned.is_none() && source == Source::Log {
            findings.extend(sensor.finding(key, None));
        }
        sensors.push(sensor);
    }
    findings.extend(turned.map(|(how, mend)| match source {
        Source::Log => format!("accelerometer: {how}: {mend}"),
        Source::Car => format!(
            "accelerometer: {how}, against board.imu: run the step imu-axes of `singletrack doctor`"
        ),
    }));
    let forward = truth(|motion| motion.forward);
    let motor = grid.smoothed(readings.motor.iter().copied(), 1);
    if let Some(mut sensor) = Sensor::of("motor", &forward, &motor) {
        // An encoder has no bias, and many drives one speed.
        (sensor.slope, sensor.slope_deviation) = ratio(&forward, &motor);
        findings.extend(match source {
            Source::Log => sensor.finding("motor.speed", Some(("motor", COUNTS))),
            // At the speed of a calibration a pulse takes long.
            Source::Car => sensor.finding_of_car(None, "step geometry"),
        });
        sensors.push(sensor);
    }
    let steering = readings.steering.iter();
    let bend = steering.map(|(time, angle)| (*time, libm::tan(*angle) / wheelbase));
    let bend = grid.smoothed(bend, 1).into_iter().zip(&forward);
    let turn: Signal = bend.map(|(bend, forward)| bend * forward).collect();
    if let Some(sensor) = Sensor::of("steering", &yaw_rate, &turn) {
        if sensor.slope < 0.0 && sensor.correlation < -AGREES {
            let key = match source {
                Source::Log => "steering.radians_per_unit",
                Source::Car => "board.servo.gain_us_per_rad",
            };
            findings.push(format!(
                "steering: the car turns to the other side than the command says: negate {key}"
            ));
        }
        sensors.push(sensor);
    }
    (sensors, findings)
}

/// The cameras' motion at equal times; none where they do not show it.
struct Grid {
    begin: Time,
    half: f64,
    motions: Vec<Option<Motion>>,
}

/// A signal at the times of the grid, NaN where it is not known.
type Signal = Vec<f64>;

impl Grid {
    fn of(track: &Track) -> Option<Self> {
        let (first, last) = (track.seen.first()?.time, track.seen.last()?.time);
        let steps = (last.seconds_since(first) / STEP) as usize;
        let motions = (0..steps).map(|step| track.motion(first.after(STEP * step as f64)));
        Some(Self {
            begin: first,
            half: track.half,
            motions: motions.collect(),
        })
    }

    fn truth(&self, value: impl Fn(&Motion) -> f64) -> Signal {
        let motions = self.motions.iter();
        motions
            .map(|motion| motion.as_ref().map_or(f64::NAN, &value))
            .collect()
    }

    /// Samples, smoothed with the weight (h² - t²) to a power; NaN where there are few.
    fn smoothed(&self, samples: impl Iterator<Item = (Time, f64)>, power: i32) -> Signal {
        let mut samples: Vec<_> = samples.collect();
        samples.sort_by_key(|(time, _)| *time);
        let at = |step: usize| {
            let now = self.begin.after(STEP * step as f64);
            let from = samples.partition_point(|(time, _)| *time <= now.before(self.half));
            let to = samples.partition_point(|(time, _)| *time < now.after(self.half));
            let around = samples.get(from..to)?;
            let (first, last) = (around.first()?.0, around.last()?.0);
            if around.len() < 4 || last.seconds_since(first) < 0.6 * (2.0 * self.half) {
                return None;
            }
            let (mut sum, mut weights) = (0.0, 0.0);
            for (time, value) in around {
                let t = time.seconds_since(now) / self.half;
                let weight = (1.0 - t * t).powi(power);
                sum += weight * value;
                weights += weight;
            }
            Some(sum / weights)
        };
        let steps = 0..self.motions.len();
        steps.map(|step| at(step).unwrap_or(f64::NAN)).collect()
    }
}

/// Sums over pairs of the truth x and what a sensor reads y: of 1, x, y, x², x y, and y².
type Sums = SVector<f64, 6>;

fn slope_and_correlation(sums: &Sums) -> Option<(f64, f64)> {
    let [count, x, y, xx, xy, yy]: [f64; 6] = (*sums).into();
    let xx = xx - x * x / count;
    let xy = xy - x * y / count;
    let yy = yy - y * y / count;
    (count > 20.0 && xx > 0.0 && yy > 0.0).then(|| (xy / xx, xy / (xx * yy).sqrt()))
}

/// Sums over all of a drive, and with each of its parts left out.
fn sums(truth: &[f64], read: &[f64], lag: isize) -> (Sums, [Sums; PARTS]) {
    let mut all = Sums::zeros();
    let mut parts = [Sums::zeros(); PARTS];
    for (step, x) in truth.iter().enumerate() {
        let later = step.checked_add_signed(lag);
        let read = later.and_then(|later| read.get(later));
        if let Some(y) = read.filter(|y| x.is_finite() && y.is_finite()) {
            let pair = Sums::from([1.0, *x, *y, x * x, x * y, y * y]);
            all += pair;
            parts[step * PARTS / truth.len()] += pair;
        }
    }
    (all, parts.map(|part| all - part))
}

/// What a sensor without bias reads of the truth, and its standard deviation.
fn ratio(truth: &[f64], read: &[f64]) -> (f64, f64) {
    let (all, parts) = sums(truth, read, 0);
    let ratio = |sums: &Sums| sums[4] / sums[3];
    (
        ratio(&all),
        left_out_deviation(&parts.each_ref().map(ratio)),
    )
}

/// The lag at which the magnitude of the correlation is largest, in steps and a share of one.
fn best_lag<'a>(sums: impl Iterator<Item = &'a Sums>) -> Option<f64> {
    let sizes = sums.map(|sums| Some(slope_and_correlation(sums)?.1.abs()));
    let sizes: Vec<Option<f64>> = sizes.collect();
    let size = |at: usize| *sizes.get(at)?;
    let known = (0..sizes.len()).filter_map(|at| Some((at, size(at)?)));
    let (best, middle) = known.max_by(|(_, a), (_, b)| a.total_cmp(b))?;
    let sides = best.checked_sub(1).and_then(size).zip(size(best + 1));
    let share = sides.map_or(0.0, |(before, after)| {
        let bend = before - 2.0 * middle + after;
        if bend < 0.0 {
            0.5 * (before - after) / bend
        } else {
            0.0
        }
    });
    Some(best as f64 + share - LAGS as f64)
}

impl Sensor {
    fn of(sensor: &'static str, truth: &[f64], read: &[f64]) -> Option<Self> {
        let by_lag: Vec<_> = (-LAGS..=LAGS).map(|lag| sums(truth, read, lag)).collect();
        let lag = best_lag(by_lag.iter().map(|(all, _)| all))?;
        let lags: Vec<f64> = (0..PARTS)
            .filter_map(|part| best_lag(by_lag.iter().map(|(_, parts)| &parts[part])))
            .collect();
        let found = Self::at(lag, sensor, truth, read)?;
        let unexplained = |correlation: f64| 1.0 - correlation * correlation;
        let without = Self::at(0.0, sensor, truth, read)?.correlation;
        Some(Self {
            lag_deviation_s: STEP * left_out_deviation(&lags),
            gain: unexplained(without) / unexplained(found.correlation).max(1e-9),
            ..found
        })
    }

    /// At a lag that is known, in steps.
    fn at(lag: f64, sensor: &'static str, truth: &[f64], read: &[f64]) -> Option<Self> {
        let (all, parts) = sums(truth, read, lag.round() as isize);
        let (slope, correlation) = slope_and_correlation(&all)?;
        let slopes: Vec<f64> = parts
            .iter()
            .filter_map(|part| Some(slope_and_correlation(part)?.0))
            .collect();
        Some(Self {
            sensor,
            slope,
            slope_deviation: left_out_deviation(&slopes),
            lag_s: STEP * lag,
            lag_deviation_s: 0.0,
            correlation,
            gain: 1.0,
        })
    }

    /// Whether the sensor says what the cameras say, and when is known.
    fn agrees(&self) -> bool {
        self.correlation.abs() > AGREES && self.lag_deviation_s < LAG_KNOWN && self.gain > BETTER
    }

    /// Whether it sees any of what the cameras say.
    fn sees(&self) -> bool {
        self.slope.abs() > SEES.max(FOUND * self.slope_deviation)
    }

    /// What is wrong with it on a car of ours, and the steps of the doctor that measure it. A lag that is
    /// its own may be so long, s.
    fn finding_of_car(&self, late: Option<f64>, steps: &str) -> Option<String> {
        let Self { sensor, slope, .. } = self;
        let is_late = late.is_some_and(|late| self.is_late(late));
        (self.correlation.abs() > AGREES && (*slope < 0.0 || self.is_scaled() || is_late)).then(|| {
            let late = if is_late {
                format!(" {:.0} ms late", 1e3 * self.lag_s)
            } else {
                String::new()
            };
            format!(
                "{sensor}: it reads {slope:.3} of what the cameras say{late}: run the {steps} of \
                 `singletrack doctor`"
            )
        })
    }

    fn is_scaled(&self) -> bool {
        (self.slope - 1.0).abs() > SCALE.max(SURE * self.slope_deviation)
    }

    fn is_late(&self, tolerance: f64) -> bool {
        self.agrees() && self.lag_s.abs() > tolerance.max(SURE * self.lag_deviation_s)
    }

    /// What is wrong with it, and the key of the map that mends it. `section` has its delay, if that is
    /// its own, and may be wrong by so much.
    fn finding(&self, key: &str, section: Option<(&str, f64)>) -> Option<String> {
        let Self { sensor, slope, .. } = self;
        if self.correlation.abs() <= AGREES {
            return None;
        }
        if *slope < 0.0 {
            return Some(format!(
                "{sensor}: it reads the other sign than the cameras ({slope:.2} of it): negate {key}"
            ));
        }
        let mut wrong = Vec::new();
        if self.is_scaled() {
            let slips = match key == "motor.speed" {
                true => ", unless its wheels slip",
                false => "",
            };
            wrong.push(format!(
                "reads {slope:.3} of what the cameras say: scale {key} by {:.3}{slips}",
                1.0 / slope
            ));
        }
        let ms = 1e3 * self.lag_s;
        if let Some((section, tolerance)) = section
            && self.is_late(tolerance)
        {
            wrong.push(match ms > 0.0 {
                true => format!("is {ms:.0} ms late: add {:.3} to {section}.delay_s", self.lag_s),
                false => format!(
                    "is {:.0} ms ahead of the cameras: take {:.3} from {section}.delay_s, or add it \
                     to pose.delay_s",
                    -ms, -self.lag_s
                ),
            });
        }
        (!wrong.is_empty()).then(|| format!("{sensor}: {}", wrong.join("; it ")))
    }
}

/// How the accelerometer is mounted.
struct Mounting {
    /// Its forward and its left axis, each beside the acceleration that it sees.
    axes: [Option<Sensor>; 2],
    /// Whether the forward axis sees the acceleration to the left, and the left one that forward.
    crossed: bool,
}

impl Mounting {
    /// `lag` is that of the gyro, in steps: both are one chip, and an accelerometer that is before or
    /// behind G feels turns sooner or later.
    fn of(moved: &[Signal; 2], read: &[Signal; 2], lag: f64) -> Self {
        const NAMES: [&str; 2] = ["accelerometer, forward", "accelerometer, left"];
        let [forward, left] = moved;
        let [ahead, beside] = read;
        let pair = |one: &Signal, other: &Signal| {
            let ahead = Sensor::at(lag, NAMES[0], one, ahead);
            [ahead, Sensor::at(lag, NAMES[1], other, beside)]
        };
        let (straight, crossed) = (pair(forward, left), pair(left, forward));
        let weight = |pair: &[Option<Sensor>; 2]| {
            let seen = pair.iter().flatten().filter(|sensor| sensor.sees());
            seen.map(|sensor| sensor.correlation.abs()).sum::<f64>()
        };
        let is_crossed = weight(&crossed) > CROSSED * weight(&straight);
        Self {
            axes: if is_crossed { crossed } else { straight },
            crossed: is_crossed,
        }
    }

    /// How it stands to the axes of the car, and what of the map of a log mends that.
    fn finding(&self) -> Option<(&'static str, String)> {
        let sign = |axis: &Option<Sensor>| {
            let sensor = axis.as_ref().filter(|sensor| sensor.sees())?;
            Some(sensor.slope > 0.0)
        };
        let [forward, left] = &self.axes;
        let (how, mend) = match (self.crossed, sign(forward), sign(left)) {
            (false, Some(false), Some(false)) => (
                "it is turned by 180 degrees",
                "negate imu.forward_acceleration and imu.left_acceleration",
            ),
            (false, Some(false), _) => (
                "its forward axis points backward",
                "negate imu.forward_acceleration",
            ),
            (false, _, Some(false)) => (
                "its left axis points to the right",
                "negate imu.left_acceleration",
            ),
            (false, ..) => return None,
            (true, Some(true), Some(false)) => (
                "it is turned by 90 degrees to the left",
                ", and negate the new forward one",
            ),
            (true, Some(false), Some(true)) => (
                "it is turned by 90 degrees to the right",
                ", and negate the new left one",
            ),
            (true, Some(false), Some(false)) => (
                "its axes are swapped, and both reversed",
                ", and negate both",
            ),
            (true, ..) => ("its axes are swapped", ""),
        };
        let swap = match self.crossed {
            true => "swap the columns of imu.forward_acceleration and imu.left_acceleration",
            false => "",
        };
        let unknown = match self.axes.iter().all(|axis| sign(axis).is_some()) {
            true => "",
            false => "; the sign of one axis does not show in this drive",
        };
        Some((how, format!("{swap}{mend}{unknown}")))
    }
}

#[cfg(test)]
mod tests {
    use core::f64::consts::FRAC_PI_2;

    use singletrack_control::{CarPose, Position};

    use super::*;
    use crate::seen;

    /// A car that weaves at 1 m/s, by cameras and IMU without noise; the IMU is `turned` to the left and
    /// its stamps are `late`.
    fn weaving(turned: f64, late: f64) -> (Track, Readings) {
        let mut poses = Vec::new();
        let mut readings = Readings::default();
        let mut position = Position::origin();
        let mut yaw = 0.0;
        for tick in 0..2_000_u32 {
            let time = 0.01 * f64::from(tick);
            let speed = 1.0 + 0.3 * libm::sin(1.7 * time);
            let yaw_rate = 2.0 * libm::sin(3.1 * time);
            let stamp = |offset: f64| Time(1_000_000_000).after(time + offset);
            poses.push((stamp(0.0), CarPose { position, yaw }));
            let (forward, left) = (0.3 * 1.7 * libm::cos(1.7 * time), speed * yaw_rate);
            let (sin, cos) = (libm::sin(turned), libm::cos(turned));
            readings.inertial.push(InertialSample {
                time: stamp(late),
                yaw_rate,
                forward_acceleration: cos * forward + sin * left,
                left_acceleration: cos * left - sin * forward,
            });
            readings.motor.push((stamp(0.0), speed));
            let steering = libm::atan(0.26 * yaw_rate / speed);
            readings.steering.push((stamp(0.0), steering));
            for step in 0..10_u32 {
                let time = time + 0.001 * f64::from(step);
                let speed = 1.0 + 0.3 * libm::sin(1.7 * time);
                position += 0.001 * speed * singletrack_control::direction(yaw);
                yaw += 0.001 * 2.0 * libm::sin(3.1 * time);
            }
        }
        (seen::tell(&poses), readings)
    }

    #[test]
    fn a_turned_or_late_imu_is_named_with_the_step_that_measures_it_and_a_right_one_is_not() {
        let found = |turned, late| {
            let (track, readings) = weaving(turned, late);
            compare(&track, &readings, 0.26, Source::Car).1
        };
        assert_eq!(found(0.0, 0.004), [""; 0]);
        let turned = found(FRAC_PI_2, 0.0).join("; ");
        assert!(
            turned.contains("turned by 90 degrees to the left, against board.imu")
                && turned.contains("step imu-axes of `singletrack doctor`"),
            "{turned}"
        );
        let late = found(0.0, 0.03).join("; ");
        assert!(
            late.contains("gyro: it reads") && late.contains("30 ms late"),
            "{late}"
        );
    }
}
