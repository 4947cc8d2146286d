//! Calibrates random cars as bring-up leaves them, and counts the intervals that hold the truth.
//!
//! `cargo run --release -p singletrack-onboard --example calibrate -- FIRST COUNT`

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a study, run by hand"
)]

use std::collections::BTreeMap;

use singletrack_commissioning::{Finding, Interrupted, Journal, Step, Verdict, calibrate, run};
use singletrack_onboard::{OnboardCar, Random, VirtualBench};
use toml_edit::{Array, Value};

struct Nothing;

impl Journal for Nothing {
    fn found(&self, _: &str) -> Option<Finding> {
        None
    }
    fn keep(&mut self, _: &Finding) -> Result<(), Interrupted> {
        Ok(())
    }
    fn begin(&mut self, _: &Step, _: usize, _: usize) {}
}

/// What doctor and bring-up would have written, with their errors.
fn brought_up(seed: u64) -> OnboardCar {
    let mut car = OnboardCar::planted(seed, None);
    let mut random = Random::new(seed ^ 0xca11);
    let truth = car.simulation.clone();
    let t = &truth.car;
    let mut set = |section: &str, key: &str, value: Value| {
        let mut item = car.file.as_table_mut() as &mut dyn toml_edit::TableLike;
        for part in section.split('.') {
            if !item.contains_key(part) {
                item.insert(part, toml_edit::Item::Table(toml_edit::Table::new()));
            }
            item = item.get_mut(part).unwrap().as_table_like_mut().unwrap();
        }
        item.insert(key, toml_edit::Item::Value(value));
    };
    let gain = t.servo.gain_us_per_rad * (1.0 + random.normal(0.03));
    let centre = t.servo.centre_us + random.normal(0.015) * gain;
    let reach = 0.9 * t.servo.stop_rad * gain.abs();
    for (key, value) in [
        ("centre_us", centre),
        ("gain_us_per_rad", gain),
        ("min_us", centre - reach - 20.0),
        ("max_us", centre + reach + 20.0),
    ] {
        set("board.servo", key, Value::from(value.round() as i64));
    }
    set(
        "limits",
        "max_steering_rad",
        Value::from((880.0 * t.servo.stop_rad).round() / 1000.0),
    );
    let edge = f64::from(t.motor.deadband_us) + t.motor.breakaway_us;
    set(
        "board.esc",
        "neutral_us",
        Value::from(i64::from(t.motor.neutral_us)),
    );
    set(
        "board.esc",
        "deadband_us",
        Value::from((edge + random.normal(1.0)).round() as i64),
    );
    let slope = 1.0 / t.motor.gain_m_s_per_us;
    set(
        "board.speed",
        "feed_forward_us_per_m_s",
        Value::from((0.8 * slope) as i64),
    );
    let pulse = t.motor_sensor.pulse_distance_um * (1.0 + random.normal(0.005));
    set(
        "board.speed",
        "pulse_distance_um",
        Value::from(pulse.min(30_000.0).round() as i64),
    );
    let body = &truth.cameras.car;
    let yaw = body.yaw_rad + random.normal(0.01);
    set(
        "motion_capture",
        "marker_yaw_rad",
        Value::from(yaw.sin().atan2(yaw.cos())),
    );
    let offset: Array = body
        .pivot()
        .into_iter()
        .map(|x| x + random.normal(0.003))
        .collect();
    set("motion_capture", "marker_offset_m", Value::Array(offset));
    let late = truth.cameras.stamp_bias_ms + random.normal(0.5);
    set(
        "motion_capture.timing",
        "stamp_offset_ms",
        Value::from(late),
    );
    let quarter = ((t.imu.mounting_deg[2] / 90.0).round() as i64).rem_euclid(4);
    let (forward, left) =
        [("+x", "+y"), ("-y", "+x"), ("-x", "-y"), ("+y", "-x")][quarter as usize];
    set("board.imu", "forward", Value::from(forward));
    set("board.imu", "left", Value::from(left));
    set("supervisor", "require_calibration", Value::from(false));
    car
}

fn main() {
    let mut arguments = std::env::args()
        .skip(1)
        .map(|text| text.parse::<u64>().unwrap());
    let (first, count) = (arguments.next().unwrap_or(0), arguments.next().unwrap_or(5));
    let mut held: BTreeMap<&str, (usize, usize, f64, f64, f64)> = BTreeMap::new();
    for seed in first..first + count {
        let car = brought_up(seed);
        let truth = &car.simulation;
        let mut bench = match VirtualBench::new(&car) {
            Ok(bench) => bench,
            Err(error) => {
                println!("{seed}: {error}");
                continue;
            }
        };
        let findings = run(&calibrate::STEPS, &mut bench, &mut Nothing).unwrap();
        let [forward, left] = truth.cameras.car.pivot();
        let m = &truth.car.motor;
        let measured = car.configuration().unwrap().vehicle.wheelbase_m();
        if count == 1 {
            println!(
                "wheelbase {:+.2} %, {:?}",
                100.0 * (measured / truth.car.vehicle.wheelbase_m() - 1.0),
                truth.car.servo
            );
        }
        let battery = &truth.car.battery;
        let voltage = bench.drive_of_host().world().truth().battery_v / battery.nominal_v;
        let pulse = |speed: f64| {
            let speed = speed / voltage;
            speed / (m.gain_m_s_per_us - speed / m.saturation_us)
        };
        for finding in &findings {
            if finding.verdict != Verdict::Good || count == 1 {
                println!(
                    "{seed} {} {:?}: {} {}",
                    finding.step, finding.verdict, finding.found, finding.fix
                );
            }
            for parameter in &finding.parameters {
                let true_value = match parameter.name {
                    "servo-centre" => truth.car.servo.centre_us,
                    "servo-gain" => truth.car.servo.gain_us_per_rad,
                    "body-yaw" => truth.cameras.car.yaw_rad,
                    "body-forward" => forward,
                    "body-left" => left,
                    "servo-lag" => 1e3 * truth.car.servo.lag_s,
                    "servo-dead-time" => 1e-3 * truth.car.servo.dead_time_us as f64,
                    "motor-lag" => 1e3 * m.lag_s,
                    "motor-dead-time" => 1e-3 * m.dead_time_us as f64,
                    "feed-forward" => (pulse(0.3) - pulse(0.15)) / 0.15,
                    _ => f64::NAN,
                };
                let e = &parameter.estimate;
                let mut error = e.value - true_value;
                let mut good = e.contains(true_value);
                if parameter.name == "body-yaw" {
                    error = error.sin().atan2(error.cos());
                    good = error.abs() <= e.half_width();
                }
                println!(
                    "{seed:4} {:16} {true_value:10.4} {:10.4} +-{:8.4} error {error:9.4} {}",
                    parameter.name,
                    e.value,
                    e.half_width(),
                    if good { "" } else { "OUT" }
                );
                let entry = held.entry(parameter.name).or_default();
                entry.0 += usize::from(good);
                entry.1 += 1;
                entry.2 += error;
                entry.3 += error * error;
                entry.4 += e.half_width();
            }
        }
    }
    for (name, (good, all, sum, squares, half)) in held {
        let n = all as f64;
        println!(
            "{name:16} {good} of {all}; mean error {:.4}, rms {:.4}, mean half width {:.4}",
            sum / n,
            (squares / n).sqrt(),
            half / n
        );
    }
}
