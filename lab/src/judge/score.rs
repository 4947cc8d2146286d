//! How the estimate compares with the smoothed cameras, the noise of the sensors, how far the path bends
//! otherwise than it is steered, and the verdict.

use std::collections::VecDeque;

use serde::Serialize;
use singletrack_commissioning::{
    seen::{self, Kind, Motion, SLOWEST_CAMERAS, Seen, Track},
    sensors::{self, Readings, Sensor, Source},
};
use singletrack_control::statistics::{Line, RootMeanSquare};
use singletrack_control::{
    EstimatorConfig, GENTLE_BEND, GRAVITY, InertialSample, PoseVerdict, Time,
};
use singletrack_core::Config;
use singletrack_pilot::{Event, Imu};

use super::run::{Compared, Log, Run, SLOWEST, Stop};

/// Below this speed a car stands, m/s.
const STANDS: f64 = 0.02;
/// The time over which white noise is told from what passes, s.
const WINDOW: f64 = 0.5;
/// The share of a normal distribution's 95 %, in standard deviations.
const WITHIN_95: f64 = 1.96;

/// The noise of a sensor, as measured against the cameras and as configured.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Noise {
    /// Which.
    pub sensor: &'static str,
    /// Unit of both values.
    pub unit: &'static str,
    /// What this log shows; none if it does not.
    pub measured: Option<f64>,
    /// What the estimator reckons with in the same moments.
    pub configured: f64,
}

/// The noise of every sensor.
pub(super) fn noise(
    track: &Track,
    samples: &[(InertialSample, f64)],
    config: &EstimatorConfig,
) -> Vec<Noise> {
    let mut position = RootMeanSquare::default();
    let mut yaw = RootMeanSquare::default();
    for now in &track.seen {
        let motion = track.motion(now.time);
        let moves = motion.is_some_and(|motion| motion.speed().abs() > STANDS);
        if let Some([x, y, turned]) = track.residual(now).filter(|_| moves) {
            position.add(x);
            position.add(y);
            yaw.add(turned);
        }
    }
    let inertial = Inertial::of(track, samples, config);
    let moving = inertial.configured.value();
    let moving = moving.unwrap_or(config.acceleration_noise_density);
    let motor = inertial.motor_configured.value();
    let motor = motor.unwrap_or(config.motor_speed_noise);
    let standing = config.acceleration_noise_density;
    let gyro = config.gyro_noise_density;
    let density = "m/s2/sqrt(Hz)";
    let all = [
        ("pose_position", "m", position, config.position_noise),
        ("pose_yaw", "rad", yaw, config.yaw_noise),
        (
            "accelerometer_standing",
            density,
            inertial.standing,
            standing,
        ),
        ("accelerometer_moving", density, inertial.moving, moving),
        ("gyro", "rad/s/sqrt(Hz)", inertial.gyro, gyro),
        ("motor_speed", "m/s", inertial.motor, motor),
    ];
    let noise = all.map(|(sensor, unit, measured, configured)| Noise {
        sensor,
        unit,
        measured: measured.value().filter(|value| value.is_finite()),
        configured,
    });
    noise.to_vec()
}

/// Densities of the noise of the IMU, over spans in which the car stood or moved.
#[derive(Clone, Copy, Debug, Default)]
struct Inertial {
    standing: RootMeanSquare,
    moving: RootMeanSquare,
    configured: RootMeanSquare,
    gyro: RootMeanSquare,
    motor: RootMeanSquare,
    motor_configured: RootMeanSquare,
}

/// Sums over one span.
#[derive(Clone, Copy, Debug, Default)]
struct Span {
    samples: u32,
    speed: f64,
    differences: [f64; 3],
}

impl Inertial {
    fn of(track: &Track, samples: &[(InertialSample, f64)], config: &EstimatorConfig) -> Self {
        let mut noise = Self::default();
        let rows = differences(track, samples);
        for (_, motor, motion, _) in rows.iter().filter(|row| row.2.forward > STANDS) {
            noise.motor.add(motor - motion.forward);
            noise
                .motor_configured
                .add(config.motor_speed_noise + config.motor_speed_scale_noise * motor.abs());
        }
        // Mean speed, mean differences and length of each span in the order of time; the mean of white
        // noise falls with the root of the length.
        let mut spans: Vec<(f64, [f64; 3], f64)> = Vec::new();
        let mut begin: Option<Time> = None;
        let mut span = Span::default();
        let mut last: Option<Time> = None;
        for (time, _, motion, [forward, left, turned]) in &rows {
            let broken = last.is_some_and(|last| time.seconds_since(last) > 0.15);
            let start = *begin.get_or_insert(*time);
            if broken || time.seconds_since(start) >= WINDOW {
                let length = last.map_or(0.0, |last| last.seconds_since(start));
                if length > 0.8 * WINDOW {
                    let samples = f64::from(span.samples);
                    let means = span.differences.map(|sum| sum / samples);
                    spans.push((span.speed / samples, means, length));
                }
                (span, begin) = (Span::default(), Some(*time));
            }
            span.samples += 1;
            span.speed += motion.speed().abs();
            for (sum, value) in span.differences.iter_mut().zip([*forward, *left, *turned]) {
                *sum += value;
            }
            last = Some(*time);
        }
        for stands in [true, false] {
            let chosen = || spans.iter().filter(|span| (span.0 < STANDS) == stands);
            for axis in 0..2 {
                let sum: f64 = chosen().map(|(_, means, _)| means[axis]).sum();
                let mean = sum / chosen().count() as f64;
                for (speed, means, length) in chosen() {
                    let density = (means[axis] - mean) * length.sqrt();
                    if stands {
                        noise.standing.add(density);
                        continue;
                    }
                    noise.moving.add(density);
                    let vibration = config.vibration_noise_density * speed;
                    let stated = libm::hypot(config.acceleration_noise_density, vibration);
                    noise.configured.add(stated);
                }
            }
            for (_, means, length) in chosen().filter(|_| !stands) {
                noise.gyro.add(means[2] * length.sqrt());
            }
        }
        noise
    }
}

/// The inertial samples less the motion by the cameras: time, speed by the motor, that motion, and
/// the differences of the accelerations forward and to the left (m/s²) and of the yaw rate (rad/s),
/// without bias and scale of the gyro.
pub(super) fn differences(
    track: &Track,
    samples: &[(InertialSample, f64)],
) -> Vec<(Time, f64, Motion, [f64; 3])> {
    let mut rows: Vec<(Time, f64, Motion, [f64; 3])> = samples
        .iter()
        .filter_map(|(sample, motor)| {
            let motion = track.motion(sample.time)?;
            let [forward, left] = motion.acceleration;
            let differences = [
                sample.forward_acceleration - forward,
                sample.left_acceleration - left,
                sample.yaw_rate - motion.yaw_rate,
            ];
            Some((sample.time, *motor, motion, differences))
        })
        .collect();
    // Bias and scale of the gyro.
    let line = Line::through(rows.iter().map(|row| [row.2.yaw_rate, row.3[2]]));
    for (_, _, motion, [_, _, turned]) in &mut rows {
        *turned -= line.at(motion.yaw_rate);
    }
    rows
}

/// The pilot ends a drive whose path bends otherwise for this long, s.
const LASTS: f64 = 0.2;
/// The growth shows from so much beyond [`GENTLE_BEND`] on, m/s².
const BEYOND: f64 = 0.5;

/// The largest deviation of the curvature that lasts as long as the pilot bears it, in the terms of
/// `[safety_filter]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Bends {
    /// In 1/m, up to a lateral acceleration of 2.45 m/s²: `curvature_error_per_m`.
    pub curvature_error_per_m: f64,
    /// What each m/s² beyond adds to it: `curvature_error_per_m_per_m_s2`; none of a drive without.
    pub curvature_error_per_m_per_m_s2: Option<f64>,
    /// The largest lateral acceleration that was steered, within what the tyres hold, in m/s².
    pub lateral_m_s2: f64,
}

/// A tick whose motion the cameras show.
#[derive(Clone, Copy)]
struct Bend {
    time: Time,
    /// Beyond the curvatures of the angles between which the wheels stand, 1/m.
    off: f64,
    /// What the angles ask for, m/s².
    lateral: f64,
}

impl Bends {
    /// The bends of a drive; none if the cameras never show a car that drives for long enough.
    pub(super) fn of(log: &Log, run: &Run, config: &Config) -> Option<Self> {
        let (wheelbase, most) = (
            config.vehicle.wheelbase_m(),
            config.vehicle.friction * GRAVITY,
        );
        let settles = 1e-3 * config.steering_settles_ms();
        let mut angles: VecDeque<(Time, f64)> = VecDeque::new();
        let mut lasting: VecDeque<Bend> = VecDeque::new();
        let mut worst: Vec<Bend> = Vec::new();
        for tick in &log.ticks {
            let now = tick.time;
            angles.push_back((now, libm::tan(tick.commanded.steering) / wheelbase));
            while angles
                .front()
                .is_some_and(|(time, _)| now.seconds_since(*time) > settles)
            {
                angles.pop_front();
            }
            let Some(motion) = run
                .track
                .motion(now)
                .filter(|motion| motion.forward > SLOWEST)
            else {
                lasting.clear();
                continue;
            };
            let ends = [f64::INFINITY, f64::NEG_INFINITY];
            let [least, greatest] = angles.iter().fold(ends, |[least, greatest], (_, bend)| {
                [least.min(*bend), greatest.max(*bend)]
            });
            let bend = motion.yaw_rate / motion.speed();
            lasting.push_back(Bend {
                time: now,
                off: (bend - greatest).max(least - bend).max(0.0),
                lateral: (motion.speed().powi(2) * least.abs().max(greatest.abs())).min(most),
            });
            let since = |bend: &Bend| now.seconds_since(bend.time);
            while lasting.get(1).is_some_and(|bend| since(bend) >= LASTS) {
                lasting.pop_front();
            }
            if lasting.front().is_some_and(|bend| since(bend) >= LASTS) {
                let all = lasting.iter();
                worst.push(Bend {
                    time: now,
                    off: all
                        .clone()
                        .map(|bend| bend.off)
                        .fold(f64::INFINITY, f64::min),
                    lateral: all.map(|bend| bend.lateral).fold(0.0, f64::max),
                });
            }
        }
        let gentle = worst.iter().filter(|bend| bend.lateral <= GENTLE_BEND);
        let curvature_error_per_m = gentle.map(|bend| bend.off).fold(0.0, f64::max);
        let beyond = worst
            .iter()
            .filter(|bend| bend.lateral > GENTLE_BEND + BEYOND);
        let growth =
            beyond.map(|bend| (bend.off - curvature_error_per_m) / (bend.lateral - GENTLE_BEND));
        (!worst.is_empty()).then(|| Self {
            curvature_error_per_m,
            curvature_error_per_m_per_m_s2: growth.reduce(f64::max).map(|growth| growth.max(0.0)),
            lateral_m_s2: worst.iter().map(|bend| bend.lateral).fold(0.0, f64::max),
        })
    }
}

/// Whether a pose's innovation counts in the mean.
pub(super) const fn counts(kind: Kind) -> bool {
    matches!(kind, Kind::Car | Kind::Jump)
}

/// What the pilot would have said of a drive, and how its estimate compares with the cameras.
#[derive(Clone, Debug, Serialize)]
pub struct Verdict {
    /// From the first tick to the last.
    pub duration_s: f64,
    /// Poses of the cameras.
    pub poses: usize,
    /// Poses of the car that the gate of the cameras or the estimator refused.
    pub rejected: usize,
    /// Times at which the estimate followed another body.
    pub adopted_ghosts: usize,
    /// Stretches of poses of another body: beginning and end.
    pub ghosts_s: Vec<[f64; 2]>,
    /// Poses of the car that were turned for a moment.
    pub flips_s: Vec<f64>,
    /// When a person would have been asked whether the body is the car.
    pub asked_s: Vec<f64>,
    /// Mean of the normalised innovation squared of every pose of the car after the estimate has
    /// settled, before any weighting, rejected poses included; 3 is right.
    pub nis_mean: Option<f64>,
    /// The median of the same, which a gap of the cameras does not move; of white noise 2.4.
    pub nis_median: Option<f64>,
    /// From when on the watches judged: every sensor of the log had been heard, and the estimate had
    /// settled.
    pub watched_from_s: Option<f64>,
    /// What would have ended a drive.
    pub stops: Vec<Stop>,
    /// The largest estimated speed after the estimate has settled.
    pub speed_max_m_s: f64,
    /// Root mean square of estimated minus smoothed speed, above 0.5 m/s.
    pub speed_rms_m_s: Option<f64>,
    /// Root mean square of the error of the yaw rate.
    pub yaw_rate_rms_rad_s: Option<f64>,
    /// Root mean square of the error of the sideslip.
    pub sideslip_rms_rad: Option<f64>,
    /// Root mean square of the sideslip itself.
    pub true_sideslip_rms_rad: Option<f64>,
    /// The share of sideslips inside their stated 95 %.
    pub sideslip_within_95: Option<f64>,
    /// The gyro's scale in the end; none without a gyro.
    pub gyro_scale: Option<f64>,
    /// Noise of every sensor.
    pub noise: Vec<Noise>,
    /// Every sensor beside the cameras.
    pub sensors: Vec<Sensor>,
    /// What is wrong with them, and the fix.
    pub findings: Vec<String>,
    /// How far the path bends otherwise than it is steered.
    pub bends: Option<Bends>,
    /// What could not be judged, for want of an input.
    pub not_judged: Vec<String>,
}

impl Verdict {
    pub(super) fn of(log: &Log, run: &Run, config: &EstimatorConfig, bends: Option<Bends>) -> Self {
        let begin = log.begin;
        let at = |seen: &Seen| seen.time.seconds_since(begin);
        let poses = run.poses.iter();
        let of_car = poses.filter(|judged| counts(judged.seen.kind));
        let rejected = of_car
            .clone()
            .filter(|judged| judged.gated || judged.verdict == Some(PoseVerdict::Implausible));
        let settled = of_car.filter(|judged| judged.settled);
        let mut innovations: Vec<f64> = settled.filter_map(|judged| judged.innovation).collect();
        let nis_mean = (!innovations.is_empty())
            .then(|| innovations.iter().sum::<f64>() / innovations.len() as f64);
        innovations.sort_by(f64::total_cmp);
        let ghosts = seen::ghosts_of(run.poses.iter().map(|judged| judged.seen));
        let mut adopted = 0;
        let mut was_adopted = false;
        for judged in &run.poses {
            let is_ghost = judged.seen.kind == Kind::Ghost;
            let is_adopted = is_ghost && judged.verdict == Some(PoseVerdict::Accepted);
            adopted += usize::from(is_adopted && !was_adopted);
            was_adopted = is_adopted;
        }
        let fast: Vec<&Compared> = run.compared.iter().filter(|one| one.is_fast()).collect();
        let rms = |error: fn(&Compared) -> f64| {
            RootMeanSquare::of(fast.iter().map(|one| error(one))).value()
        };
        let within = fast
            .iter()
            .filter(|one| one.sideslip_error().abs() <= WITHIN_95 * one.deviation);
        let within_95 = within.count() as f64 / fast.len() as f64;
        let readings = readings(log, run);
        let (sensors, findings) =
            sensors::compare(&run.track, &readings, config.wheelbase, Source::Log);
        let flips = run.track.seen.iter().filter(|seen| seen.kind == Kind::Flip);
        Self {
            duration_s: log.duration(),
            poses: run.poses.len(),
            rejected: rejected.count(),
            adopted_ghosts: adopted,
            ghosts_s: ghosts
                .iter()
                .map(|ghost| ghost.map(|time| time.seconds_since(begin)))
                .collect(),
            flips_s: flips.map(at).collect(),
            asked_s: run.asked.clone(),
            nis_mean,
            nis_median: innovations.get(innovations.len() / 2).copied(),
            watched_from_s: run.watched_from,
            stops: run.stops.clone(),
            speed_max_m_s: run.speed_max,
            speed_rms_m_s: rms(|one| one.speed - one.truth.speed()),
            yaw_rate_rms_rad_s: rms(|one| one.yaw_rate - one.truth.yaw_rate),
            sideslip_rms_rad: rms(Compared::sideslip_error),
            true_sideslip_rms_rad: rms(|one| one.truth.sideslip()),
            sideslip_within_95: (!fast.is_empty()).then_some(within_95),
            gyro_scale: run.gyro_scale,
            noise: noise(&run.track, &run.samples, config),
            sensors,
            findings,
            bends,
            not_judged: not_judged(log, run),
        }
    }
}

/// What is compared with the cameras; the steering is that of the tick in which the board was heard.
fn readings(log: &Log, run: &Run) -> Readings {
    let mut readings = Readings {
        inertial: run.samples.iter().map(|(sample, _)| *sample).collect(),
        ..Readings::default()
    };
    for tick in &log.ticks {
        for event in &tick.events {
            if let Event::Board(board) = event {
                readings.motor.push((board.time, board.motor_speed));
                let steering = tick.commanded.steering;
                readings.steering.push((board.time, steering));
            }
        }
    }
    readings
}

fn not_judged(log: &Log, run: &Run) -> Vec<String> {
    let missing = [
        (true, "arming"),
        (true, "the proving run"),
        (true, "the end of a stop"),
        (true, "the law"),
        (log.imu == Imu::Missing, "the gyro"),
        (log.imu != Imu::Whole, "the accelerometer"),
        (!log.has_speed, "the commanded speed"),
        (!log.has_health, "battery, stop switch and real time"),
        (!log.has_attitude, "tilt, height and the cameras' clock"),
    ];
    let mut missing: Vec<String> = missing
        .into_iter()
        .filter(|(is_missing, _)| *is_missing)
        .map(|(_, what)| what.to_owned())
        .collect();
    if run.track.rate() < SLOWEST_CAMERAS {
        missing.push(format!(
            "the errors of the estimate and the sensors (poses come at {:.0} Hz, and 20 are needed)",
            run.track.rate()
        ));
    }
    missing
}
