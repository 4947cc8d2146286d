//! What an eight says about a calibration that is wrong, and what the correction is worth.
//!
//! ```sh
//! cargo run --release -p singletrack-scenario --example online_calibration -- [SEEDS [SCENARIO]] [live]
//! ```
//!
//! Prints for each error the estimates, in thousandths (? is not observable, ! is off), and the
//! root mean square of the distance of P from its reference before and after the estimates that
//! are off are written into the configuration; with `live`, also that of the second half of a drive
//! twice as long, which learns. Then how many intervals hold the truth. Another scenario is driven
//! without an error.

use std::{env, error::Error, path::Path};

use singletrack_control::CalibrationParameter;
use singletrack_core::{
    Config,
    config::OnlineCalibrationMode,
    online_calibration::{corrected, corrections},
};
use singletrack_scenario::simulate::{
    RunOptions, Scenario, Simulation, simulate_configured, virtual_drive_config,
};

const EIGHT: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../scenarios/best/eight-6x3.toml"
);

/// Parameters with their true deviations.
type Deviations = &'static [(CalibrationParameter, f64)];

/// What is wrong, in the words of `[truth]`, and the true deviations.
const ERRORS: &[(&str, &str, Deviations)] = &[
    ("nothing", "", &[]),
    (
        "wheels turn 20 % less",
        "[truth.servo]\ngain_us_per_rad = -1000.0",
        &[(CalibrationParameter::SteeringGain, -0.2)],
    ),
    (
        "wheels turn 25 % more",
        "[truth.servo]\ngain_us_per_rad = -640.0",
        &[(CalibrationParameter::SteeringGain, 0.25)],
    ),
    (
        "trim 3 degrees",
        "[truth.servo]\ncentre_us = 1541.9",
        &[(CalibrationParameter::SteeringTrim, 0.052_4)],
    ),
    (
        "stamps 20 ms late",
        "[truth.cameras]\nstamp_bias_ms = 20.0",
        &[(CalibrationParameter::StampOffset, 0.02)],
    ),
    (
        "stamps 20 ms early",
        "[truth.cameras]\nstamp_bias_ms = -20.0",
        &[(CalibrationParameter::StampOffset, -0.02)],
    ),
    (
        "body yaw 1 degree",
        "[truth.cameras]\nbody_yaw_deg = 1.0",
        &[(CalibrationParameter::BodyYaw, 0.017_45)],
    ),
    (
        "pivot 10 mm forward",
        "[truth.cameras]\npivot_m = [0.01, 0.0]",
        &[(CalibrationParameter::PivotForward, 0.01)],
    ),
    (
        "pivot 10 mm left",
        "[truth.cameras]\npivot_m = [0.0, 0.01]",
        &[(CalibrationParameter::PivotLeft, 0.01)],
    ),
    (
        "gyro 3 % more",
        "[truth.imu]\ngyro_scale = 1.03",
        &[(CalibrationParameter::GyroScale, 0.03)],
    ),
    (
        "pulses 3 % farther",
        "[truth.motor_sensor]\npulse_distance_um = 3090.0",
        &[(CalibrationParameter::PulseDistance, 0.03)],
    ),
];

/// How many estimates of a parameter were observable, how many of those had the truth in their
/// interval, and their squared errors.
#[derive(Clone, Copy, Default)]
struct Coverage {
    observable: u32,
    inside: u32,
    squares: f64,
}

/// Drives a scenario, with this configuration of the daemon.
fn drive(scenario: &Scenario, daemon: &Config) -> Result<Simulation, Box<dyn Error>> {
    let (_, simulation) = virtual_drive_config(scenario)?;
    let options = RunOptions::default();
    Ok(simulate_configured(scenario, daemon, &simulation, options)?)
}

fn rms_mm(simulation: &Simulation) -> f64 {
    let summary = simulation.summary.as_ref();
    let rms_m = summary.and_then(|summary| summary.tracking_rms_m);
    1e3 * rms_m.unwrap_or(f64::NAN)
}

fn main() -> Result<(), Box<dyn Error>> {
    let is_live = env::args().any(|argument| argument == "live");
    let mut arguments = env::args().skip(1).filter(|argument| argument != "live");
    let seeds: u64 = arguments.next().map_or(Ok(1), |count| count.parse())?;
    let file = arguments.next();
    let path = file.as_ref().map_or_else(|| Path::new(EIGHT), Path::new);
    let text = std::fs::read_to_string(path)?;
    let errors = match file {
        Some(_) => &ERRORS[..1],
        None => ERRORS,
    };
    let mut coverage = [Coverage::default(); CalibrationParameter::ALL.len()];
    let mut false_advice = 0;
    for (name, truth, deviations) in errors {
        for seed in 1..=seeds {
            let run = format!(
                "{text}seed = {seed}\n{truth}\n[online_calibration]\nmode = \"advice\"\n\
                 [supervisor]\nprove_first_metre = false\n"
            );
            let scenario = Scenario::from_toml(&run, path)?;
            let (daemon, _) = virtual_drive_config(&scenario)?;
            let before = drive(&scenario, &daemon)?;
            print!("{name}, seed {seed}: {:.2} mm", rms_mm(&before));
            let corrections = corrections(&daemon, &before.estimates);
            if !corrections.is_empty() {
                let after = drive(&scenario, &corrected(&daemon, &corrections)?)?;
                print!(" -> {:.2} mm", rms_mm(&after));
            }
            if is_live {
                let mut daemon = daemon.clone();
                daemon.online_calibration.mode = OnlineCalibrationMode::Live;
                // The summary counts the second half, in which it has learned.
                let mut scenario = scenario.clone();
                scenario.run.duration_s *= 2.0;
                let live = drive(&scenario, &daemon)?;
                print!(", live {:.2} mm", rms_mm(&live));
                for note in &live.notes {
                    print!(" ({note})");
                }
            }
            for (estimate, coverage) in before.estimates.iter().zip(&mut coverage) {
                let truth = deviations
                    .iter()
                    .find(|(of, _)| *of == estimate.parameter)
                    .map_or(0.0, |(_, value)| *value);
                let error = estimate.value - truth;
                if estimate.observable {
                    coverage.observable += 1;
                    coverage.inside += u32::from(error.abs() <= estimate.half_width);
                    coverage.squares += error * error;
                    false_advice += u32::from(truth == 0.0 && estimate.is_off());
                }
                let mark = match (estimate.observable, estimate.is_off()) {
                    (false, _) => "?",
                    (true, true) => "!",
                    (true, false) => "",
                };
                let [value, half] = [estimate.value, estimate.half_width].map(|it| 1e3 * it);
                print!("; {} {value:.2} +- {half:.2}{mark}", estimate.parameter);
            }
            println!();
        }
    }
    for (parameter, coverage) in CalibrationParameter::ALL.iter().zip(coverage) {
        let Coverage {
            observable,
            inside,
            squares,
        } = coverage;
        let deviation = 1e3 * (squares / f64::from(observable)).sqrt();
        println!("{parameter}: {inside} of {observable} inside, deviation {deviation:.3}");
    }
    println!("wrong advice: {false_advice}");
    Ok(())
}
