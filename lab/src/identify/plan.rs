//! `singletrack identify --plan`: how well a drive shows each calibrated parameter, before it is
//! driven.

#![deny(clippy::disallowed_methods, reason = "simulated drives begin here")]

use std::{
    f64::consts::{PI, TAU},
    path::Path,
};

use singletrack_control::{CalibrationParameter, Start};
use singletrack_core::{
    config::{Config, OnlineCalibrationMode, PathPoints, ReferenceSection},
    online_calibration::{OnlineCalibration, units},
};
use singletrack_pilot::{Mode, Reason};
use singletrack_scenario::{
    csv_text::csv_text,
    simulate::{CarError, Scenario, virtual_drive_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{SimulationConfig, StartPose};

use super::IdentifyError;

/// How long a path that does not end is driven, in s...
const DURATION: f64 = 90.0;
/// ...and the short one: the estimates begin after 36 s.
const SHORT: f64 = 45.0;

/// Seeds of which the variance of the noise is the mean.
const SEEDS: u64 = 3;

/// Points of a path.
const POINTS: u32 = 200;

/// The share of the room inside the geofence that P may use: the car swings out.
const ROOM: f64 = 0.8;

/// The share of the noise that is left of the sensors without noise: values that repeat bit by
/// bit are those of a stuck sensor.
const ALMOST_NONE: f64 = 0.01;

/// A place of a path, in m, by the phase of its lap, in rad.
type Shape<'a> = &'a dyn Fn(f64) -> [f64; 2];

/// What a drive of a path shows.
#[derive(Clone, Debug)]
pub struct PlannedPath {
    /// Its name.
    pub name: &'static str,
    /// Time of the drive, in s, and the least standard deviation of each parameter of the online
    /// calibration, in its own unit, `None` if the drive does not show it; or why the car can't
    /// drive it.
    pub drive: Result<(f64, [Option<f64>; CalibrationParameter::ALL.len()]), String>,
}

impl PlannedPath {
    /// The worst deviation as a share of what matters; infinite if anything is not shown.
    #[must_use]
    pub fn worst(&self) -> f64 {
        let Ok((_, deviations)) = &self.drive else {
            return f64::INFINITY;
        };
        let shares = CalibrationParameter::ALL.iter().zip(deviations);
        shares
            .map(|(of, deviation)| deviation.map_or(f64::INFINITY, |it| it / of.threshold()))
            .fold(0.0, f64::max)
    }
}

/// Drives the reference of a scenario, and paths in the room inside its geofence.
///
/// # Errors
///
/// The scenario can't be read, or not be driven by the simulated car.
pub fn plan(scenario: &Path) -> Result<Vec<PlannedPath>, IdentifyError> {
    let scenario = Scenario::read(scenario).map_err(CarError::from)?;
    let (mut config, car) = virtual_drive_config(&scenario)?;
    config.online_calibration.mode = OnlineCalibrationMode::Advice;
    config.supervisor.prove_first_metre = false;
    let margin_m = config.fence.margin_m(&config.vehicle);
    let [(x, a), (y, b)] = [0, 1].map(|axis| {
        let ends = config.fence.corners_m.iter().map(|corner| corner[axis]);
        let least = ends.clone().fold(f64::INFINITY, f64::min);
        let most = ends.fold(f64::NEG_INFINITY, f64::max);
        let room = ROOM * (0.5 * (most - least) - margin_m);
        (0.5 * (least + most), room)
    });
    let radius = a.min(b).min(1.0);
    let [large, small] = [6.0, 1.5].map(|most: f64| a.min(2.0 * b).min(most));
    let eight =
        |half: f64, phase: f64| [half * libm::sin(phase), 0.5 * half * libm::sin(2.0 * phase)];
    let circle = |phase: f64| [radius * libm::cos(phase), radius * libm::sin(phase)];
    let wave = |phase: f64| [large * (phase / PI - 1.0), 0.1 * libm::sin(large * phase)];
    let shapes: [(_, bool, _, Shape<'_>); 4] = [
        ("circle", true, DURATION, &circle),
        ("eight", true, DURATION, &|phase| eight(large, phase)),
        ("short eight", true, SHORT, &|phase| eight(small, phase)),
        ("wave", false, DURATION, &wave),
    ];
    let mut paths = vec![planned("of the scenario", &config, &car, DURATION)];
    for (name, closed, duration, at) in shapes {
        let points = (0..POINTS).map(|index| at(TAU * f64::from(index) / f64::from(POINTS)));
        let points: Vec<_> = points.map(|[dx, dy]| [x + dx, y + dy]).collect();
        let [[x, y], [next_x, next_y]] = [points[0], points[1]];
        let yaw_rad = libm::atan2(next_y - y, next_x - x);
        let reach = car.car.vehicle.front_axle_distance_m + config.law.point_distance_m;
        let (mut config, mut car) = (config.clone(), car.clone());
        car.car.start = StartPose {
            x_m: x - reach * libm::cos(yaw_rad),
            y_m: y - reach * libm::sin(yaw_rad),
            yaw_rad,
        };
        let limits = &config.limits;
        config.reference = ReferenceSection::Path {
            points: PathPoints::Points(points),
            closed,
            start: Start::Beginning,
            speed_m_s: limits.max_speed_m_s.min(1.0),
            lateral_acceleration_m_s2: 0.5 * limits.max_lateral_acceleration_m_s2,
            acceleration_m_s2: 0.5 * limits.max_acceleration_m_s2,
        };
        paths.push(planned(name, &config, &car, duration));
    }
    Ok(paths)
}

/// Drives a path without noise, and under some seeds with it.
fn planned(
    name: &'static str,
    config: &Config,
    car: &SimulationConfig,
    duration: f64,
) -> PlannedPath {
    let deviations = || {
        let (time, free) = drive(config, &quiet(car), duration)?;
        let mut squares = [Some(0.0); CalibrationParameter::ALL.len()];
        for seed in 1..=SEEDS {
            let mut noisy = car.clone();
            noisy.seed = seed;
            let (_, noisy) = drive(config, &noisy, duration)?;
            for (sum, bound) in squares.iter_mut().zip(noisy.bounds(&free)) {
                *sum = sum.zip(bound).map(|(sum, bound)| sum + bound * bound);
            }
        }
        let mean = |sum: f64| (sum / SEEDS as f64).sqrt();
        Ok((time, squares.map(|sum| sum.map(mean))))
    };
    PlannedPath {
        name,
        drive: deviations(),
    }
}

/// The same car with sensors almost without noise.
#[must_use]
pub fn quiet(car: &SimulationConfig) -> SimulationConfig {
    let mut quiet = car.clone();
    let cameras = &mut quiet.cameras;
    cameras.position_noise_m *= ALMOST_NONE;
    cameras.orientation_noise_rad *= ALMOST_NONE;
    let imu = &mut quiet.car.imu;
    *imu = imu.without_vibration();
    imu.gyro_noise_rad_s *= ALMOST_NONE;
    imu.acceleration_noise_m_s2 *= ALMOST_NONE;
    quiet
}

/// Drives for at most this time (s), and gives the time that it took and what the drive says.
///
/// # Errors
///
/// Why the car does not drive, or stopped before.
pub fn drive(
    config: &Config,
    car: &SimulationConfig,
    duration: f64,
) -> Result<(f64, OnlineCalibration), String> {
    let mut drive = VirtualDrive::new(config.clone(), car.seed, car.clone())
        .map_err(|error| error.to_string())?;
    let mut calibration = OnlineCalibration::of(config);
    let mut tick = drive.start().map_err(|error| error.to_string())?;
    let begin = tick.now;
    loop {
        calibration.tick(&tick.tick);
        let time = tick.now.seconds_since(begin);
        let output = &tick.tick.output;
        match (output.mode, output.reason) {
            (Mode::Driving, _) if time < duration => tick = drive.step(),
            (Mode::Driving, _) | (_, Some(Reason::ReferenceFinished)) => {
                return Ok((time, calibration));
            }
            (mode, reason) => {
                let reason = reason.map_or(mode.name(), Reason::name);
                return Err(format!("{reason} after {time:.1} s"));
            }
        }
    }
}

/// The columns of the table.
const COLUMNS: [&str; 6] = ["path", "time_s", "parameter", "unit", "deviation", "note"];

/// The plan as a table: for a person, or as CSV.
#[must_use]
pub fn table(paths: &[PlannedPath], is_csv: bool) -> String {
    let best = paths
        .iter()
        .map(PlannedPath::worst)
        .fold(f64::INFINITY, f64::min);
    let mut rows = vec![COLUMNS.map(str::to_owned)];
    for path in paths {
        let name = path.name.to_owned();
        let (time, deviations) = match &path.drive {
            Ok(drive) => drive,
            Err(reason) => {
                let [time, parameter, unit, deviation] = [const { String::new() }; 4];
                let note = format!("not driven: {reason}");
                rows.push([name, time, parameter, unit, deviation, note]);
                continue;
            }
        };
        let is_best = best.is_finite() && path.worst() <= best;
        for (parameter, deviation) in CalibrationParameter::ALL.into_iter().zip(deviations) {
            let (_, unit, scale, digits) = units(parameter);
            let note = match deviation {
                None => "not observable",
                Some(_) if is_best => "best path",
                Some(_) => "",
            };
            rows.push([
                name.clone(),
                format!("{time:.1}"),
                parameter.name().to_owned(),
                unit.to_owned(),
                deviation.map_or_else(String::new, |it| format!("{:.1$}", scale * it, digits + 2)),
                note.to_owned(),
            ]);
        }
    }
    if is_csv {
        return csv_text(rows);
    }
    let line = |[path, time, parameter, unit, deviation, note]: [String; 6]| {
        let line = format!("{path:16}{time:>7}  {parameter:16}{deviation:>10} {unit:5} {note}");
        format!("{}\n", line.trim_end())
    };
    rows.into_iter().map(line).collect()
}
