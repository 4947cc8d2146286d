//! The onboarding of simulated cars.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod killed;
mod procedures;

use singletrack_commissioning::{Answer, Answers, Bench, Question};
use singletrack_control::SteeringTable;
use singletrack_onboard::{OnboardCar, PlantedFault, VirtualBench, onboard_until};
use singletrack_sim::{WIDE_US, crooked_steering};

#[test]
fn every_random_owner_writes_a_valid_configuration() {
    for seed in 0..300 {
        let car = OnboardCar::random(seed);
        let config = car
            .configuration()
            .unwrap_or_else(|error| panic!("{seed}: {error}"));
        assert_eq!(config.motion_capture.marker_offset_m, [0.0; 2]);
        assert!(config.board.esc.kind.is_none());
    }
}

#[test]
fn about_a_tenth_of_the_cars_has_a_fault_and_every_fault_occurs() {
    let faults: Vec<_> = (0..1_000)
        .filter_map(|seed| OnboardCar::random(seed).fault)
        .collect();
    assert!((70..130).contains(&faults.len()), "{}", faults.len());
    for fault in PlantedFault::ALL {
        assert!(faults.contains(&fault), "{fault}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let observed = || {
        let mut bench = VirtualBench::new(&OnboardCar::planted(3, None)).unwrap();
        let mut observed = Vec::new();
        for id in ["push-forward", "nose-up", "on-stand", "place-on-floor"] {
            let answer = bench
                .ask(&Question {
                    id,
                    text: "".into(),
                    answers: Answers::Begin,
                })
                .unwrap();
            assert_ne!(answer, Answer::Skip);
            for _ in 0..300 {
                bench.wait(&mut observed).unwrap();
            }
        }
        format!("{observed:?}")
    };
    assert_eq!(observed(), observed());
}

#[test]
fn a_bench_begins_with_a_board_that_is_ready() {
    let bench = VirtualBench::new(&OnboardCar::planted(1, None)).unwrap();
    assert!(bench.seconds() < 10.0);
    assert!(bench.guard().violations().is_empty());
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn steering_that_is_no_straight_line_gets_its_table() {
        let mut car = OnboardCar::planted(7, None);
        let servo = &mut car.simulation.car.servo;
        let line = [servo.centre_us, servo.gain_us_per_rad];
        let pairs = crooked_steering(line, WIDE_US, [0.15, 0.0]);
        servo.table = Some(SteeringTable::new(&pairs).unwrap());
        let servo = servo.clone();
        // That of another servo, which the bring-up must replace.
        let old = "steering_table = [[1080, 0.525], [1500, 0.0], [1920, -0.525]]";
        let text = car.file.to_string().replace("\n[actuators]\n", "\n");
        car.file = format!("{text}\n[actuators]\n{old}\n").parse().unwrap();
        car.configuration().unwrap();
        let outcome = onboard_until(&car, false);
        assert!(outcome.passed, "{}", outcome.text(true));
        let finding = outcome
            .findings
            .iter()
            .find(|(_, finding)| finding.step == "bends");
        let parameters = &finding.unwrap().1.parameters;
        let bend = parameters
            .iter()
            .find(|parameter| parameter.name == "steering-bend");
        let (_, table) = bend.unwrap().key.clone().unwrap();
        let pairs: Vec<[f64; 2]> = table
            .as_array()
            .unwrap()
            .iter()
            .map(|pair| {
                let numbers = pair.as_array().unwrap();
                [0, 1].map(|index| numbers.get(index).unwrap().as_float().unwrap())
            })
            .collect();
        for [pulse, angle] in &pairs {
            println!("{pulse}: {angle}, {:.4}", servo.target(*pulse as u16));
        }
        let table = SteeringTable::new(&pairs).unwrap();
        for angle in [-0.3, -0.15, 0.0, 0.15, 0.3] {
            let truly = servo.target(table.pulse(angle) as u16);
            println!("{angle}: {truly:.4}");
            // The axles, measured with a ruler, make a hundredth of every angle.
            assert!(
                (truly - angle).abs() < 0.004 + 0.015 * angle.abs(),
                "{angle}: {truly}"
            );
        }
    }

    #[test]
    fn every_planted_fault_is_found_before_the_car_drives() {
        for (seed, fault) in (40..).zip(PlantedFault::ALL) {
            let outcome = onboard_until(&OnboardCar::planted(seed, Some(fault)), true);
            assert!(outcome.found, "{fault}: {}", outcome.text(true));
            assert_eq!(outcome.violations, [""; 0], "{fault}");
            assert!(outcome.unknown.is_empty(), "{fault}: {:?}", outcome.unknown);
        }
    }
}
