//! The doctor on random cars, with scripted hands.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use core::f64::consts::TAU;

use singletrack_commissioning::{
    Answer, Attendance, Bench, Finding, Interrupted, Jog, Live, Observation, Parameter, Question,
    Refused, Step, Verdict, doctor, run,
};
use singletrack_control::{Position, Velocity};
use singletrack_core::Config;
use singletrack_onboard::{NoJournal, OnboardCar, PlantedFault, VirtualBench};
use singletrack_protocol::BoardMode;

/// A car that nothing but a hand may move.
struct Disarmed {
    bench: VirtualBench,
    /// Ticks that are not observed after an answer: a hand may be faster than the terminal.
    lost_ticks: u32,
}

impl Bench for Disarmed {
    fn wait(&mut self, observed: &mut Vec<Observation>) -> Result<(), Interrupted> {
        let before = observed.len();
        self.bench.wait(observed)?;
        for observation in observed.iter().skip(before) {
            if let Observation::Board(board) = observation {
                assert!(
                    !matches!(
                        board.mode,
                        BoardMode::Armed | BoardMode::Driving | BoardMode::Jogging
                    ),
                    "{board:?}"
                );
            }
        }
        Ok(())
    }

    fn ask(&mut self, question: &Question) -> Result<Answer, Interrupted> {
        let answer = self.bench.ask(question)?;
        for _ in 0..self.lost_ticks {
            self.wait(&mut Vec::new())?;
        }
        Ok(answer)
    }

    fn show(&mut self, live: &Live<'_>) {
        assert!(live.done.is_finite() && !live.text.is_empty(), "{live:?}");
        self.bench.show(live);
    }

    fn arm(&mut self, _: Attendance) -> Result<(), Refused> {
        panic!("the doctor arms the car");
    }

    fn jog(&mut self, _: Jog) -> Result<(), Refused> {
        panic!("the doctor jogs");
    }

    fn drive(&mut self, _: Velocity, _: Option<Position>) -> Result<(), Refused> {
        panic!("the doctor drives");
    }

    fn disarm(&mut self) -> Result<(), Refused> {
        self.bench.disarm()
    }

    fn emergency_stop(&mut self) -> Result<(), Refused> {
        self.bench.emergency_stop()
    }

    fn configuration(&self) -> &Config {
        self.bench.configuration()
    }

    fn change(&mut self, values: &[(&str, toml_edit::Value)]) -> Result<(), Refused> {
        self.bench.change(values)
    }
}

fn examined(car: &OnboardCar) -> (Vec<Finding>, VirtualBench) {
    let (findings, disarmed) = examined_in(&doctor::STEPS, car, 0);
    (findings, disarmed.bench)
}

fn examined_in(steps: &[Step], car: &OnboardCar, lost_ticks: u32) -> (Vec<Finding>, Disarmed) {
    let mut disarmed = Disarmed {
        bench: VirtualBench::new(car).unwrap(),
        lost_ticks,
    };
    let findings = run(steps, &mut disarmed, &mut NoJournal).unwrap();
    (findings, disarmed)
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
fn a_reset_that_is_faster_than_the_terminal_is_seen() {
    for lost_ticks in [0, 1, 2, 5, 10] {
        let car = OnboardCar::planted(3, None);
        let (findings, _) = examined_in(&doctor::STEPS[..1], &car, lost_ticks);
        let board = findings.first().unwrap();
        assert_eq!(board.verdict, Verdict::Good, "{lost_ticks}: {board:?}");
    }
}

#[test]
fn a_body_of_another_car_is_found_by_the_push() {
    for seed in 0..3 {
        let car = OnboardCar::planted(seed, Some(PlantedFault::WrongBody));
        let (findings, _) = examined(&car);
        let last = findings.last().unwrap();
        assert_eq!(
            (last.step.as_ref(), last.verdict),
            ("cameras", Verdict::Failed),
            "{last:?}"
        );
        assert!(last.found.contains("not on this car"), "{last:?}");
    }
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn the_parameters_of_random_cars_are_inside_their_intervals() {
        let cars = 5;
        let mut missed = Vec::new();
        for seed in 0..cars {
            let car = OnboardCar::planted(seed, None);
            let (findings, _) = examined(&car);
            for (name, truth) in truths(&car) {
                let Some(parameter) = parameter(&findings, name) else {
                    missed.push((seed, name, None));
                    continue;
                };
                let estimate = parameter.estimate;
                // The same angle, also where the numbers jump by a turn.
                let truth = match parameter.unit.as_ref() {
                    "rad" => estimate.value + libm::remainder(truth - estimate.value, TAU),
                    _ => truth,
                };
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
}
