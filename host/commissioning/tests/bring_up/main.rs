//! The bring-up of small simulated cars by a scripted operator.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

mod car;

use std::collections::BTreeMap;

use car::MockCar;
use singletrack_commissioning::{
    Finding, Interrupted, Journal, Parameter, Step, Verdict, bring_up, run,
};
use singletrack_control::statistics::Random;
use singletrack_core::Config;

/// Keeps the findings in memory.
#[derive(Default)]
struct Memory(BTreeMap<String, Finding>);

impl Journal for Memory {
    fn found(&self, step: &str) -> Option<Finding> {
        self.0.get(step).cloned()
    }

    fn keep(&mut self, finding: &Finding) -> Result<(), Interrupted> {
        self.0.insert(finding.step.to_string(), finding.clone());
        Ok(())
    }

    fn begin(&mut self, _: &Step, number: usize, of: usize) {
        assert!(number <= of);
    }
}

fn bring_up_car(car: &mut MockCar) -> Vec<Finding> {
    run(&bring_up::steps_with::<5>(), car, &mut Memory::default()).unwrap()
}

fn random_car(seed: u64) -> MockCar {
    MockCar::new(Truth::random(&mut numbers(seed)), seed)
}

fn usual() -> Truth {
    Truth {
        kill_output: false,
        kind: Kind::Car,
        ..Truth::random(&mut numbers(7))
    }
}

fn explain(findings: &[Finding]) -> String {
    findings
        .iter()
        .map(|finding| {
            let word = finding.verdict.name();
            format!(
                "{}: {word}: {} [{}]\n",
                finding.step, finding.found, finding.fix
            )
        })
        .collect()
}

fn parameters(findings: &[Finding]) -> BTreeMap<String, Parameter> {
    findings
        .iter()
        .flat_map(|finding| &finding.parameters)
        .map(|parameter| (parameter.name.to_string(), parameter.clone()))
        .collect()
}

/// The last finding failed, and is of this step.
fn assert_fails_at(findings: &[Finding], step: &str, says: &str) {
    let last = findings.last().unwrap();
    assert!(
        last.step == step && last.verdict == Verdict::Failed && last.found.contains(says),
        "{}",
        explain(findings)
    );
}

#[test]
fn a_car_on_the_floor_is_stopped_within_centimetres() {
    for seed in 0..10 {
        let truth = Truth {
            on_stand: false,
            kill_output: false,
            ..Truth::random(&mut numbers(seed))
        };
        let mut car = MockCar::new(truth, seed);
        let findings = bring_up_car(&mut car);
        assert_fails_at(&findings, "kill", "the cameras saw the car move");
        assert_eq!(car.emergency_stops, 1);
        assert!(car.way_m.abs() < 0.12, "{}", car.way_m);
    }
}

#[test]
fn a_car_that_leaves_its_stand_after_the_pulses_have_ended_gets_an_emergency_stop() {
    let mut car = MockCar::new(
        Truth {
            falls_off: true,
            ..usual()
        },
        1,
    );
    let findings = bring_up_car(&mut car);
    assert_fails_at(&findings, "motor-direction", "the cameras saw the car move");
    assert_eq!(car.emergency_stops, 1);
}

#[test]
fn a_kill_output_that_does_nothing_is_found_before_anything_turns() {
    let mut car = MockCar::new(
        Truth {
            kill_output: true,
            relay_works: false,
            ..usual()
        },
        1,
    );
    let findings = bring_up_car(&mut car);
    assert_fails_at(&findings, "kill", "although the kill output is off");
    assert!(car.fastest_m_s == 0.0);
}

#[test]
fn swapped_wires_are_found_by_the_motor_that_turns_with_the_servo() {
    for seed in 0..10 {
        let truth = Truth {
            swapped: true,
            kill_output: true,
            ..Truth::random(&mut numbers(seed))
        };
        let mut car = MockCar::new(truth, seed);
        let findings = bring_up_car(&mut car);
        assert_fails_at(&findings, "servo-direction", "while the servo's pulse");
        assert!(car.fastest_m_s < 0.9, "{}", car.fastest_m_s);
    }
}

#[test]
fn a_motor_that_turns_backward_fails() {
    let mut car = MockCar::new(
        Truth {
            backward: true,
            ..usual()
        },
        1,
    );
    assert_fails_at(&bring_up_car(&mut car), "motor-direction", "backward");
}

#[test]
fn a_motor_without_a_pulse_sensor_fails() {
    let mut car = MockCar::new(
        Truth {
            sensor_dead: true,
            kill_output: true,
            ..usual()
        },
        1,
    );
    assert_fails_at(&bring_up_car(&mut car), "motor-direction", "no motor pulse");
}

#[test]
fn an_esc_whose_neutral_is_elsewhere_fails_at_rest() {
    let mut car = MockCar::new(
        Truth {
            neutral_us: 1_440.0,
            ignored_us: 20.0,
            ..usual()
        },
        1,
    );
    assert_fails_at(&bring_up_car(&mut car), "stand", "the motor turns");
}

#[test]
fn an_esc_that_holds_its_last_pulse_fails() {
    let mut car = MockCar::new(
        Truth {
            holds_s: 0.5,
            ..usual()
        },
        1,
    );
    let findings = bring_up_car(&mut car);
    assert_fails_at(&findings, "stop-silence", "slow down");
}

#[test]
fn an_esc_that_drives_on_without_pulses_fails() {
    let mut car = MockCar::new(
        Truth {
            runs_without_pulses: true,
            ..usual()
        },
        1,
    );
    let findings = bring_up_car(&mut car);
    let reset = findings.iter().find(|found| found.step == "stop-reset");
    assert!(reset.is_some_and(|found| found.verdict == Verdict::Warning));
    assert_fails_at(&findings, "stop-unplug", "drove on");
}

#[test]
fn the_board_tells_whether_the_cable_takes_its_power_along() {
    let kept = "supply of its own";
    let lost = "takes the board's power along";
    for (own_supply, kill_output, says, by_eye) in [
        (true, false, kept, false),
        (true, true, kept, false),
        (false, true, lost, false),
        (false, false, lost, true),
    ] {
        let truth = Truth {
            own_supply,
            kill_output,
            ..usual()
        };
        let mut car = MockCar::new(truth, 1);
        let findings = bring_up_car(&mut car);
        let found = findings.iter().find(|found| found.step == "stop-unplug");
        assert!(
            found.is_some_and(|it| it.verdict == Verdict::Good && it.found.contains(says)),
            "{}",
            explain(&findings)
        );
        // Once for the reset.
        let asked = car.asked.iter().filter(|id| **id == "stopped-how").count();
        assert_eq!(asked, 1 + usize::from(by_eye), "{own_supply} {kill_output}");
    }
}

#[test]
fn a_stop_switch_without_effect_fails() {
    let mut car = MockCar::new(
        Truth {
            switch_works: false,
            ..usual()
        },
        1,
    );
    assert_fails_at(&bring_up_car(&mut car), "stop-switch", "did not notice");
}

#[test]
fn a_daemon_that_loses_the_board_for_a_moment_jogs_again_and_one_that_loses_it_always_says_so() {
    for (losses, passes) in [(2, true), (u32::MAX, false)] {
        let mut car = MockCar::new(usual(), 1);
        car.losses = losses;
        let findings = bring_up_car(&mut car);
        let text = explain(&findings);
        let passed = findings.iter().all(|found| found.verdict < Verdict::Failed);
        assert_eq!(passed, passes, "{text}");
        assert_eq!(text.contains("board lost: silence"), !passes, "{text}");
    }
}

#[test]
fn an_interrupted_bring_up_goes_on_where_it_was_and_leaves_a_disarmed_car() {
    let mut car = MockCar::new(usual(), 1);
    let mut journal = Memory::default();
    let steps = bring_up::steps_with::<5>();
    for question in ["wheel-angle", "driven-wheels", "unplug"] {
        car.interrupt_at = Some(question);
        let interrupted = run(&steps, &mut car, &mut journal).unwrap_err();
        assert_eq!(interrupted, Interrupted::ByOperator);
        Config::from_toml(&car.text).unwrap();
    }
    car.interrupt_at = None;
    let findings = run(&steps, &mut car, &mut journal).unwrap();
    assert_eq!(findings.len(), 16, "{}", explain(&findings));
    assert_eq!(car.asked.iter().filter(|id| **id == "on-stand").count(), 1);
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn random_cars_are_brought_up_and_their_intervals_hold_the_truth() {
        const CARS: u64 = 100;
        let mut held: BTreeMap<&str, (u32, u32)> = BTreeMap::new();
        for seed in 0..CARS {
            let mut car = random_car(seed);
            let findings = bring_up_car(&mut car);
            let explained = || format!("{seed}: {:?}\n{}", car.truth, explain(&findings));
            let done = findings.iter().all(|found| found.verdict < Verdict::Failed);
            assert!(done && findings.len() == 16, "{}", explained());
            assert!(car.fastest_m_s < 1.05, "{}", explained());
            let truth = &car.truth;
            let standing = truth.ignored_us + truth.breakaway_us;
            // At 0.5 m/s.
            let linear = 0.5 / truth.gain_m_s_per_us;
            let needed = linear / (1.0 - linear / truth.saturation_us) / 0.5;
            let found = parameters(&findings);
            for (name, truth) in [
                ("servo-centre", truth.centre_us),
                ("servo-gain", truth.gain_us_per_rad),
                ("esc-neutral", truth.neutral_us),
                ("esc-deadband", standing),
                ("feed-forward", needed),
            ] {
                let Some(interval) = found.get(name).map(|found| found.estimate) else {
                    panic!("{name}: {}", explained());
                };
                let count = held.entry(name).or_default();
                count.0 += u32::from(interval.contains(truth));
                count.1 += 1;
                if !interval.contains(truth) {
                    println!("{seed} {:?} {name} {truth}: {interval:?}", car.truth.kind);
                }
            }
            let config = Config::from_toml(&car.text).unwrap();
            let Some(kind) = found.get("esc-kind") else {
                panic!("{}", explained())
            };
            let kind = kind.key.as_ref().unwrap().1.as_str().unwrap();
            assert_eq!(kind, truth.kind.name(), "{}", explained());
            let sign = config.board.servo.gain_us_per_rad.signum();
            assert_eq!(f64::from(sign), truth.gain_us_per_rad.signum());
            for limit in [config.board.servo.min_us, config.board.servo.max_us] {
                let angle = (f64::from(limit) - truth.centre_us) / truth.gain_us_per_rad;
                assert!(angle.abs() <= truth.stop_rad, "{}", explained());
            }
        }
        println!("{held:?}");
        assert!(
            held.values().all(|(held, of)| held * 100 >= of * 90),
            "{held:?}"
        );
    }
}

/// The random numbers of a car.
pub(crate) fn numbers(seed: u64) -> Random {
    Random::new(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x5EED)
}

/// What a pulse below neutral does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Car,
    ForwardReverse,
    Vesc,
}

impl Kind {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Car => "car",
            Self::ForwardReverse => "forward-reverse",
            Self::Vesc => "vesc",
        }
    }
}

/// What is true of the car.
#[derive(Clone, Debug)]
pub(crate) struct Truth {
    pub(crate) centre_us: f64,
    pub(crate) gain_us_per_rad: f64,
    pub(crate) stop_rad: f64,
    pub(crate) play_us: f64,
    pub(crate) kind: Kind,
    pub(crate) neutral_us: f64,
    pub(crate) ignored_us: f64,
    pub(crate) breakaway_us: f64,
    pub(crate) gain_m_s_per_us: f64,
    pub(crate) saturation_us: f64,
    pub(crate) lag_s: f64,
    pub rolling_m_s2: f64,
    pub(crate) pulse_distance_m: f64,
    pub(crate) on_stand: bool,
    pub(crate) swapped: bool,
    pub(crate) backward: bool,
    pub(crate) sensor_dead: bool,
    pub(crate) kill_output: bool,
    pub(crate) relay_works: bool,
    /// The board has a supply besides the cable.
    pub(crate) own_supply: bool,
    /// The ESC holds its last pulse for so long after a change to neutral.
    pub(crate) holds_s: f64,
    /// The ESC drives on without pulses.
    pub(crate) runs_without_pulses: bool,
    pub(crate) switch_works: bool,
    /// The car falls off its stand when it is disarmed while its wheels turn.
    pub(crate) falls_off: bool,
}

impl Truth {
    pub(crate) fn random(random: &mut Random) -> Self {
        let sign = if random.between(0.0, 1.0) < 0.5 {
            -1.0
        } else {
            1.0
        };
        let kind = [Kind::Car, Kind::ForwardReverse, Kind::Vesc][random.between(0.0, 3.0) as usize];
        Self {
            centre_us: random.between(1_430.0, 1_570.0),
            gain_us_per_rad: sign * random.between(600.0, 1_000.0),
            stop_rad: random.between(0.4, 0.6),
            play_us: random.between(0.0, 12.0),
            kind,
            neutral_us: random.between(1_490.0, 1_510.0).round(),
            ignored_us: random.between(15.0, 40.0).round(),
            breakaway_us: random.between(1.0, 8.0),
            gain_m_s_per_us: random.between(0.006, 0.016),
            saturation_us: random.between(300.0, 600.0),
            lag_s: random.between(0.04, 0.12),
            rolling_m_s2: random.between(0.5, 2.0),
            pulse_distance_m: random.between(0.001, 0.025),
            on_stand: true,
            swapped: false,
            backward: false,
            sensor_dead: false,
            kill_output: random.between(0.0, 1.0) < 0.5,
            relay_works: true,
            own_supply: false,
            holds_s: 0.0,
            runs_without_pulses: false,
            switch_works: true,
            falls_off: false,
        }
    }
}
