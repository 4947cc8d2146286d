//! The noise of the IMU at rest and with the wheels turning: a step of the doctor, which relies on
//! the stand and on the kill switch.

use super::{
    car::{Car, armed},
    kill,
    request::change,
    spin::mean_speed,
    stand,
};
use crate::{
    Bench, BoardReading, Finding, Inertial, Plot, PlotKind, PlotLine, Step, Trouble, Verdict,
    finding::failed,
    imu_noise::{Comparison, NoiseLevel, compare},
    parameter::keys,
};

pub(super) const STEP: Step =
    Step::new("imu-noise", "IMU: its noise with the wheels turning", find)
        .expecting("The noise at every speed is at most 1.3 times what [estimator] believes.");

/// Time at rest, s.
const REST_S: f64 = 15.0;

/// Speeds of the wheels, m/s; the board ends a jog beyond 1.0.
const SPEEDS: [f64; 3] = [0.25, 0.5, 0.7];

/// Runs at each speed, and the time in which a speed settles and is measured, s. The board allows
/// 10 s of driving without a rest.
const RUNS: usize = 3;
const SETTLE_S: f64 = 1.0;
const MEASURE_S: f64 = 4.0;

fn find(bench: &mut dyn Bench) -> Result<Finding, Trouble> {
    // In every run: the car may have been put down after an interruption.
    stand::find(bench)?;
    let kill = kill::find(bench)?;
    let at_rest = Car::look(bench)?.watch(REST_S, "at rest")?;
    let mut levels = vec![level(0.0, &[at_rest])?];
    for wanted in SPEEDS {
        let runs = armed(bench, |car| runs(car, wanted))?;
        let speed = mean_speed(&runs.concat());
        levels.push(level(speed, &runs)?);
    }
    let comparison = compare(&levels, &bench.configuration().estimator);
    bench.plot(&plot(&levels));
    let keys = keys(&comparison.parameters);
    if !keys.is_empty() {
        change(bench, &keys)?;
    }
    Ok(finding(comparison, &kill))
}

/// The telemetry of some runs at about this speed, m/s.
fn runs(car: &mut Car<'_>, wanted: f64) -> Result<Vec<Vec<BoardReading>>, Trouble> {
    let jog = car.spin(wanted)?;
    let rest = car.rest();
    let mut runs = Vec::new();
    for _ in 0..RUNS {
        car.hold_until_standing(rest, 0.8)?;
        car.hold(jog, SETTLE_S, "settling")?;
        runs.push(car.hold(jog, MEASURE_S, "measuring the IMU")?);
    }
    Ok(runs)
}

/// The noise in some runs.
fn level(speed: f64, runs: &[Vec<BoardReading>]) -> Result<NoiseLevel, Trouble> {
    let samples: Vec<Vec<Inertial>> = runs
        .iter()
        .map(|run| run.iter().filter_map(|reading| reading.inertial).collect())
        .collect();
    NoiseLevel::of(speed, &samples).ok_or_else(|| {
        let count = samples.concat().len();
        let found = format!("{count} samples of the IMU at {speed:.2} m/s");
        let fix = "Look at the IMU's wires (SDA, SCL, 5 V, ground): docs/uno.md.";
        failed(found, fix)
    })
}

fn finding(comparison: Comparison, kill: &Finding) -> Finding {
    let mut found = comparison.found;
    let mut fixes = Vec::new();
    if !comparison.too_small.is_empty() {
        let too_small = comparison.too_small.join(", ");
        found.push(format!(
            "too small: {too_small}; the measured values are in force"
        ));
        fixes.push(
            "The floor shakes more than a stand: compare `noise` of `singletrack judge` after the \
             first drive.",
        );
    }
    if kill.verdict == Verdict::Warning {
        found.push(kill.found.clone());
        fixes.push(&kill.fix);
    }
    let fix = fixes.join(" ");
    Finding::warning_if(!fixes.is_empty(), found.join("; "), &fix).with(comparison.parameters)
}

fn plot(levels: &[NoiseLevel]) -> Plot {
    let line = |name, kind, density: fn(&NoiseLevel) -> f64| {
        let points = levels.iter().map(|level| [level.speed, density(level)]);
        PlotLine::new(name, kind, points.collect())
    };
    Plot {
        name: "imu-noise",
        title: "The accelerometer's noise with the wheels turning",
        x: ("speed of the wheels", "m/s"),
        y: ("noise density", "m/s²/√Hz"),
        equal: false,
        lines: vec![
            line("forward", PlotKind::Measured, |level| {
                level.forward.density.value
            }),
            line("left", PlotKind::Other, |level| level.left.density.value),
        ],
    }
}
