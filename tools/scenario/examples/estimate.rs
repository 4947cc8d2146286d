//! How far the estimate is from the truth in drives of the simulated car.
//!
//! ```sh
//! cargo run --release -p singletrack-scenario --example estimate -- --first-seed 101 --seeds 10 \
//!     tools/scenarios/circle-car.toml tools/scenarios/best/eight-6x3.toml
//! ```
//!
//! Prints for each file, over all seeds and from 5 s on: root mean squares of the errors of yaw rate,
//! sideslip and speed; the mean of the normalised squares of sideslip and of the poses' innovations (of
//! a consistent estimate 1 and 3), and the share of sideslips within the stated 95 %; the root mean square
//! of the step of the steering from tick to tick; and that of P beside its reference, from 10 s on. Each `--with TEXT`
//! drives with other values, such as `'truth.servo.lag_ms = 80'`. With `--perfect` the law gets the truth
//! for the estimate, which goes on beside it.

#![allow(
    clippy::disallowed_methods,
    reason = "an example prints figures of three digits"
)]

use std::{env, error::Error, fs};

use singletrack_control::statistics::RootMeanSquare;
use singletrack_control::wrap;
use singletrack_scenario::{
    simulate::{Scenario, virtual_drive_config},
    virtual_drive::VirtualDrive,
};
use toml::{Table, Value};

/// From here on the start no longer counts, in s.
const SETTLED: f64 = 5.0;
/// From here on P is compared with its reference, in s.
const FOLLOWS: f64 = 10.0;
/// The sideslip is not compared below this speed, m/s.
const MOVES: f64 = 0.15;

fn main() -> Result<(), Box<dyn Error>> {
    let (mut first, mut seeds, mut seconds, mut perfect) = (1, 1, 40.0, false);
    let (mut cars, mut files) = (Vec::new(), Vec::new());
    let mut arguments = env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{argument} needs a value"));
        match argument.as_str() {
            "--first-seed" => first = value()?.parse()?,
            "--seeds" => seeds = value()?.parse()?,
            "--seconds" => seconds = value()?.parse()?,
            "--with" => cars.push(value()?),
            "--perfect" => perfect = true,
            _ => files.push(argument),
        }
    }
    if cars.is_empty() {
        cars.push(String::new());
    }
    println!("yaw_rate sideslip  speed NEES within95  NIS step_mrad  P_mm ended file");
    for car in cars {
        if !car.is_empty() {
            println!("{car}");
        }
        for file in &files {
            let mut scenario = scenario(&fs::read_to_string(file)?, &car)?;
            let mut errors = Errors::default();
            for seed in first..first + seeds {
                scenario.run.seed = seed;
                errors.drive(&scenario, seconds, perfect)?;
            }
            errors.print(file);
        }
    }
    Ok(())
}

/// The scenario of a file, with other values.
fn scenario(file: &str, other: &str) -> Result<Scenario, toml::de::Error> {
    let mut scenario: Table = toml::from_str(file)?;
    merge(&mut scenario, toml::from_str(other)?);
    scenario.try_into()
}

fn merge(into: &mut Table, other: Table) {
    for (key, value) in other {
        match (into.get_mut(&key), value) {
            (Some(Value::Table(into)), Value::Table(other)) => merge(into, other),
            (_, value) => {
                into.insert(key, value);
            }
        }
    }
}

#[derive(Default)]
struct Errors {
    yaw_rate: RootMeanSquare,
    sideslip: RootMeanSquare,
    speed: RootMeanSquare,
    normalised: RootMeanSquare,
    innovation: RootMeanSquare,
    step: RootMeanSquare,
    beside: RootMeanSquare,
    within: u32,
    compared: u32,
    ended: u32,
}

impl Errors {
    fn drive(
        &mut self,
        scenario: &Scenario,
        seconds: f64,
        perfect: bool,
    ) -> Result<(), Box<dyn Error>> {
        let (daemon, simulation) = virtual_drive_config(scenario)?;
        let reference = scenario.reference()?;
        let p = daemon.law.point_distance_m;
        let front = simulation.car.vehicle.front_axle_distance_m;
        let mut drive = Box::new(VirtualDrive::new(daemon, scenario.run.seed, simulation)?);
        if perfect {
            drive.know_the_truth();
        }
        let first = drive.start()?;
        let mut steering: Option<f64> = None;
        loop {
            let tick = drive.step();
            let time = tick.now.seconds_since(first.now);
            if time > seconds.min(scenario.run.duration_s) {
                return Ok(());
            }
            let output = &tick.tick.output;
            let Some(drive_time) = output.drive_time else {
                self.ended += 1;
                return Ok(());
            };
            let sent = output.actuation.steering;
            let before = steering.replace(sent);
            let Some(estimate) = output.estimate.filter(|_| time > SETTLED) else {
                continue;
            };
            let truth = &tick.truth;
            self.yaw_rate.add(estimate.yaw_rate - truth.yaw_rate);
            self.speed.add(estimate.speed - truth.speed);
            let estimator = drive.controller().pilot.estimator();
            self.innovation.add_square(estimator.innovation());
            if truth.speed.abs() > MOVES {
                let off = wrap(estimate.sideslip - truth.sideslip);
                let variance = estimator.sideslip_variance();
                self.sideslip.add(off);
                self.normalised.add_square(off * off / variance);
                self.compared += 1;
                self.within += u32::from(off * off <= 1.96 * 1.96 * variance);
            }
            if let Some(before) = before {
                self.step.add(sent - before);
            }
            let path = output.path.unwrap_or(drive_time);
            let wanted = reference.at(path).position;
            if let Some(wanted) = wanted.filter(|_| time > FOLLOWS) {
                let wheels = truth.yaw + truth.steering;
                let x = truth.x + front * truth.yaw.cos() + p * wheels.cos();
                let y = truth.y + front * truth.yaw.sin() + p * wheels.sin();
                self.beside
                    .add_square((x - wanted.x).powi(2) + (y - wanted.y).powi(2));
            }
        }
    }

    fn print(&self, file: &str) {
        let of = |mean: &RootMeanSquare| mean.value().unwrap_or(f64::NAN);
        println!(
            "{:8.4} {:8.4} {:6.4} {:4.2} {:7.1}% {:5.2} {:8.2} {:6.2} {:4} {file}",
            of(&self.yaw_rate),
            of(&self.sideslip),
            of(&self.speed),
            of(&self.normalised).powi(2),
            100.0 * f64::from(self.within) / f64::from(self.compared),
            of(&self.innovation).powi(2),
            1e3 * of(&self.step),
            1e3 * of(&self.beside),
            self.ended,
        );
    }
}
