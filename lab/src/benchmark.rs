//! `singletrack-lab benchmark`: estimate and identification on the public logs of real cars, with a split
//! into logs that were chosen on and logs that are held out.

use std::{
    error::Error,
    fmt::Write as _,
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use clap::Args;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use singletrack_analysis::identification::SimulationPoint;
use singletrack_control::statistics::RootMeanSquare;
use singletrack_core::Config;
use singletrack_figures::output::print;
use singletrack_logs::import::import;

use crate::{
    Format, Result,
    identify::{self, Identified, IdentifyArgs, SlipAngleKind},
    judge::{WHOLE, judge},
};

/// Options of `singletrack-lab benchmark`.
#[derive(Clone, Debug, Args)]
pub struct BenchmarkArgs {
    /// The folder with the logs, at any depth.
    pub folder: PathBuf,

    /// The cars, their maps and configurations, and the split of their logs.
    #[arg(
        long,
        value_name = "CARS.toml",
        default_value = "tools/real/benchmark.toml"
    )]
    pub cars: PathBuf,

    /// How to print the results.
    #[arg(long, value_enum, default_value_t = Format::Table)]
    pub format: Format,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Cars {
    car: Vec<Car>,
}

/// A car of the benchmark.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Car {
    name: String,
    /// Where its logs are public, and which state of them this is.
    source: String,
    commit: String,
    /// Files, from the folder of the one that has this.
    map: PathBuf,
    config: PathBuf,
    /// Names of the logs.
    chosen: Vec<String>,
    held_out: Vec<String>,
}

#[derive(Serialize)]
struct CarResult {
    car: String,
    source: String,
    commit: String,
    logs: Vec<LogResult>,
    parameters: Vec<ParameterResult>,
    warnings: Vec<String>,
}

#[derive(Serialize)]
struct ParameterResult {
    name: &'static str,
    unit: &'static str,
    value: f64,
    interval_95: [f64; 2],
}

#[derive(Serialize)]
struct LogResult {
    log: String,
    held_out: bool,
    seconds: f64,
    nis_median: Option<f64>,
    speed_rms_m_s: Option<f64>,
    yaw_rate_rms_rad_s: Option<f64>,
    sideslip_rms_rad: Option<f64>,
    sideslip_within_95: Option<f64>,
    stops: Vec<&'static str>,
    /// Root mean square of the yaw rate that the identified car predicts, alone with steering and speed,
    /// less the measured one; of a log that is held out.
    identified_rms_rad_s: Option<f64>,
    /// Root mean square for the car of the configuration, with the identified steering: for DART, the
    /// parameters that its authors give.
    configured_rms_rad_s: Option<f64>,
    /// Root mean square of the error of the yaw rate that the plain fit predicts.
    plain_rms_rad_s: Option<f64>,
}

/// Runs the benchmark and prints its results.
///
/// # Errors
///
/// What can't be read, imported, judged or identified.
pub fn run(args: &BenchmarkArgs) -> Result {
    let at = |path: &Path, error: &dyn Error| format!("{}: {error}", path.display());
    let text = fs::read_to_string(&args.cars).map_err(|error| at(&args.cars, &error))?;
    let cars: Cars = toml::from_str(&text).map_err(|error| at(&args.cars, &error))?;
    let mut files = Vec::new();
    collect(&args.folder, &mut files).map_err(|error| at(&args.folder, &error))?;
    let beside = args.cars.parent().unwrap_or(Path::new(""));
    let mut results = Vec::new();
    for car in cars.car {
        results.push(measured(car, beside, &files)?);
    }
    let printed = match args.format {
        Format::Table => results.iter().map(table).collect(),
        Format::Json => {
            serde_json::to_string_pretty(&serde_json::json!({ "cars": results }))? + "\n"
        }
    };
    Ok(print(&printed)?)
}

/// All files of a folder and those below it.
fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        match path.is_dir() {
            true => collect(&path, files)?,
            false => files.push(path),
        }
    }
    Ok(())
}

fn measured(car: Car, beside: &Path, files: &[PathBuf]) -> Result<CarResult> {
    let (map, config_path) = (beside.join(&car.map), beside.join(&car.config));
    let config = Config::read(&config_path)?;
    let records = tempfile::tempdir()?;
    let (mut logs, mut record, mut validate) = (Vec::new(), Vec::new(), Vec::new());
    let chosen = car.chosen.iter().map(|name| (name, false));
    for (name, held_out) in chosen.chain(car.held_out.iter().map(|name| (name, true))) {
        let is_it = |path: &&PathBuf| path.file_name().is_some_and(|file| *file == **name);
        let file = files.iter().find(is_it).ok_or_else(|| {
            format!(
                "the folder has no {name}: get the logs of {} from {}",
                car.name, car.source
            )
        })?;
        // Standard error may be closed.
        let _ = writeln!(io::stderr().lock(), "singletrack: {}, {name}", car.name);
        let made = records.path().join(format!("{name}.mcap"));
        import(&[file], &map, &made, |_, _| {})?;
        let (verdict, _) = judge(&made, &config, WHOLE, |_, _| {})?;
        logs.push(LogResult {
            log: name.clone(),
            held_out,
            seconds: verdict.duration_s,
            nis_median: verdict.nis_median,
            speed_rms_m_s: verdict.speed_rms_m_s,
            yaw_rate_rms_rad_s: verdict.yaw_rate_rms_rad_s,
            sideslip_rms_rad: verdict.sideslip_rms_rad,
            sideslip_within_95: verdict.sideslip_within_95,
            stops: verdict.stops.iter().map(|stop| stop.reason).collect(),
            identified_rms_rad_s: None,
            configured_rms_rad_s: None,
            plain_rms_rad_s: None,
        });
        if held_out {
            validate.push(made);
        } else {
            record.push(made);
        }
    }
    let report = identify::identify(&IdentifyArgs {
        config: Some(config_path),
        slip_angles: SlipAngleKind::Exact,
        validate_nominal: true,
        ..IdentifyArgs::of(record, validate)
    })?;
    let identification = &report.identified.identification;
    let plain = Plain::fit(&identification.simulation, config.vehicle.wheelbase_m());
    let error = |points: &[SimulationPoint]| {
        let errors = points.iter();
        let errors = errors.map(|point| point.yaw_rate_rad_s - point.measured_yaw_rate_rad_s);
        RootMeanSquare::of(errors).value()
    };
    let on = |validated: &[Identified], log: &str| {
        let is_it = |one: &&Identified| {
            let record = one.logs.first().and_then(|log| log.path.file_stem());
            record == Some(log.as_ref())
        };
        let found = validated.iter().find(is_it)?;
        Some(found.identification.simulation.clone())
    };
    for log in &mut logs {
        if let Some(points) = on(&report.validated, &log.log) {
            log.identified_rms_rad_s = error(&points);
            log.plain_rms_rad_s = plain.and_then(|plain| plain.rms(&points));
        }
        log.configured_rms_rad_s =
            on(&report.nominal_validated, &log.log).and_then(|points| error(&points));
    }
    let estimates = identification.estimates.iter();
    let parameters = estimates.map(|estimate| ParameterResult {
        name: estimate.parameter.name(),
        unit: estimate.parameter.unit(),
        value: estimate.value,
        interval_95: estimate.interval,
    });
    let warnings = identification.warnings.iter().map(ToString::to_string);
    Ok(CarResult {
        parameters: parameters.collect(),
        warnings: warnings.chain(report.not_validated).collect(),
        car: car.name,
        source: car.source,
        commit: car.commit,
        logs,
    })
}

/// A plain fit, beside which an identification must be worth its while: the steady turn of a car that
/// understeers, r = v (g δ + θ) / (L + K v²), by linear least squares through the same angles of the
/// wheels. The trim θ is that of each drive, as it is for the identified car.
#[derive(Clone, Copy, Debug)]
struct Plain {
    wheelbase: f64,
    gain: f64,
    understeer: f64,
}

impl Plain {
    fn fit(points: &[SimulationPoint], wheelbase: f64) -> Option<Self> {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for point in points {
            let (speed, rate) = (point.speed_m_s, point.measured_yaw_rate_rad_s);
            let row = Vector3::new(speed * point.steering_rad, speed, -speed * speed * rate);
            normal += row * row.transpose();
            right += row * (wheelbase * rate);
        }
        let found = normal.try_inverse()? * right;
        Some(Self {
            wheelbase,
            gain: found.x,
            understeer: found.z,
        })
    }

    /// Root mean square of its error on a drive, rad/s.
    fn rms(&self, points: &[SimulationPoint]) -> Option<f64> {
        let rows = points.iter().map(|point| {
            let speed = point.speed_m_s;
            let per_angle = speed / (self.wheelbase + self.understeer * speed * speed);
            let rate = per_angle * self.gain * point.steering_rad;
            [per_angle, point.measured_yaw_rate_rad_s - rate]
        });
        let sum = |of: fn([f64; 2]) -> f64| rows.clone().map(of).sum::<f64>();
        let trim = sum(|[angle, left]| angle * left) / sum(|[angle, _]| angle * angle);
        RootMeanSquare::of(rows.clone().map(|[angle, left]| angle * trim - left)).value()
    }
}

fn table(result: &CarResult) -> String {
    let number = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
    };
    let mut text = format!(
        "{}, {} at {}\n{:<64} {:>6} {:>6} {:>7} {:>7} {:>8} {:>6} {:>10} {:>10} {:>6}  stops\n",
        result.car,
        result.source,
        result.commit,
        "log (* chosen on)",
        "s",
        "NIS",
        "speed",
        "yaw r.",
        "sideslip",
        "in 95",
        "identified",
        "configured",
        "plain",
    );
    for log in &result.logs {
        let mark = if log.held_out { "" } else { " *" };
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{:<64} {:>6.1} {:>6} {:>7} {:>7} {:>8} {:>6} {:>10} {:>10} {:>6}  {}",
            format!("{}{mark}", log.log),
            log.seconds,
            number(log.nis_median, 2),
            number(log.speed_rms_m_s, 3),
            number(log.yaw_rate_rms_rad_s, 3),
            number(log.sideslip_rms_rad, 4),
            number(log.sideslip_within_95, 2),
            number(log.identified_rms_rad_s, 3),
            number(log.configured_rms_rad_s, 3),
            number(log.plain_rms_rad_s, 3),
            log.stops.join(" "),
        );
    }
    for parameter in &result.parameters {
        let [low, high] = parameter.interval_95;
        let _ = writeln!(
            text,
            "{:<14} {:>10.5} {:<6} ({low:.5} to {high:.5})",
            parameter.name, parameter.value, parameter.unit
        );
    }
    text + "\n"
}
