//! The doctor on random cars, with scripted hands.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use core::f64::consts::TAU;

use singletrack_commissioning::{
    Bench, Finding, Interrupted, Journal, Parameter, Step, Verdict, doctor, run,
};
use singletrack_onboard::{OnboardCar, PlantedFault, VirtualBench};

/// Keeps nothing.
struct NoJournal;

impl Journal for NoJournal {
    fn found(&self, _: &str) -> Option<Finding> {
        None
    }

    fn keep(&mut self, _: &Finding) -> Result<(), Interrupted> {
        Ok(())
    }

    fn begin(&mut self, _: &Step, _: usize, _: usize) {}
}

fn examined(car: &OnboardCar) -> (Vec<Finding>, VirtualBench) {
    let mut bench = VirtualBench::new(car).unwrap();
    let findings = run(&doctor::STEPS, &mut bench, &mut NoJournal).unwrap();
    (findings, bench)
}

fn parameter<'a>(findings: &'a [Finding], name: &str) -> Option<&'a Parameter> {
    findings
        .iter()
        .flat_map(|finding| &finding.parameters)
        .find(|parameter| parameter.name == name)
}

/// What is true of the parameters that the doctor measures.
fn truths(car: &OnboardCar) -> Vec<(&'static str, f64)> {
    let simulation = &car.simulation;
    let pivot = simulation.cameras.car.pivot();
    vec![
        (
            "pulse-distance",
            simulation.car.motor_sensor.pulse_distance_um,
        ),
        ("body-yaw", simulation.cameras.car.yaw_rad),
        ("body-forward", pivot[0]),
        ("body-left", pivot[1]),
        ("camera-latency", simulation.cameras.stamp_bias_ms),
    ]
}

#[test]
fn the_parameters_of_random_cars_are_inside_their_intervals() {
    let cars = 20;
    let mut missed = Vec::new();
    for seed in 0..cars {
        let car = OnboardCar::planted(seed, None);
        let (findings, bench) = examined(&car);
        if std::env::var("SHOW").is_ok() {
            for finding in &findings {
                println!(
                    "{seed} {} {}: {} | {}",
                    finding.step,
                    finding.verdict.name(),
                    finding.found,
                    finding.fix
                );
            }
            println!("{:?} {:.0} s", bench.unknown_questions(), bench.seconds());
        }
        for (name, truth) in truths(&car) {
            let Some(parameter) = parameter(&findings, name) else {
                missed.push((seed, name, None));
                continue;
            };
            let estimate = parameter.estimate;
            // The same angle, also where the numbers jump by a turn.
            let truth = match parameter.unit {
                "rad" => estimate.value + libm::remainder(truth - estimate.value, TAU),
                _ => truth,
            };
            if std::env::var("SHOW").is_ok() {
                println!(
                    "{seed} {name} {truth:.4} {:.4} +- {:.4}",
                    estimate.value,
                    estimate.half_width()
                );
            }
            if !estimate.contains(truth) {
                missed.push((seed, name, Some((truth, estimate))));
            }
        }
    }
    for (name, _) in truths(&OnboardCar::planted(0, None)) {
        let count = missed.iter().filter(|one| one.1 == name).count();
        assert!(count * 10 <= cars as usize, "{name}: {missed:#?}");
    }
}

#[test]
fn a_body_of_another_car_is_found_by_the_push() {
    for seed in 0..3 {
        let car = OnboardCar::planted(seed, Some(PlantedFault::WrongBody));
        let (findings, _) = examined(&car);
        let last = findings.last().unwrap();
        assert_eq!(
            (last.step, last.verdict),
            ("cameras", Verdict::Failed),
            "{last:?}"
        );
        assert!(last.found.contains("not on this car"), "{last:?}");
    }
}

#[test]
fn an_imu_that_hangs_upside_down_is_found_and_its_axes_are_corrected() {
    for seed in 0..3 {
        let car = OnboardCar::planted(seed, Some(PlantedFault::ImuUpsideDown));
        let (findings, bench) = examined(&car);
        let axes = findings.iter().find(|one| one.step == "imu-axes").unwrap();
        assert_eq!(axes.verdict, Verdict::Warning, "{axes:?}");
        let imu = bench.configuration().board.imu;
        let words = [imu.forward, imu.left, imu.up].map(|axis| format!("{axis:?}"));
        assert_eq!(words, ["PlusX", "MinusY", "MinusZ"], "{axes:?}");
        let rest = findings.iter().find(|one| one.step == "rest").unwrap();
        assert_eq!(rest.verdict, Verdict::Good, "{rest:?}");
    }
}
