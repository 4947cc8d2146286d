//! The procedures on random cars: the doctor with scripted hands, the noise of the IMU with the
//! wheels turning on a stand against what is true of it, and the bring-up of cars that are not on
//! their stand, by hands that do not lift them.

use core::f64::consts::TAU;

use singletrack_commissioning::{
    Answer, Attendance, Bench, Finding, Interrupted, Jog, Observation, Parameter, Question,
    Refused, Step, Verdict, bring_up, doctor, run,
};
use singletrack_control::{Position, Velocity};
use singletrack_core::Config;
use singletrack_onboard::{NoJournal, OnboardCar, PlantedFault, VirtualBench};
use singletrack_protocol::BoardMode;
use toml_edit::value;

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

    fn show(&mut self, text: &str, done: f64) {
        assert!(done.is_finite() && !text.is_empty(), "{text}: {done}");
        self.bench.show(text, done);
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

    #[test]
    fn a_car_on_the_floor_is_stopped_within_15_cm() {
        for seed in 0..12 {
            let car = OnboardCar::planted(seed, None);
            let mut bench = OnTheFloor {
                bench: VirtualBench::new(&car).unwrap(),
                emergency_stops: 0,
                farthest_m: 0.0,
                place: None,
            };
            let findings = run(&bring_up::steps_with::<5>(), &mut bench, &mut NoJournal).unwrap();
            let last = findings.last().unwrap();
            assert_eq!(last.verdict, Verdict::Failed, "{seed}: {}", last.found);
            assert!(
                last.found.contains("the cameras saw the car move"),
                "{seed} {}: {}",
                last.step,
                last.found
            );
            assert_eq!(bench.emergency_stops, 1, "{seed}");
            // It rolls out after the stop.
            let mut observed = Vec::new();
            for _ in 0..300 {
                bench.wait(&mut observed).unwrap();
            }
            assert!(bench.farthest_m < 0.15, "{seed}: {} m", bench.farthest_m);
        }
    }
}

const GYRO: &str = "gyro-noise-density";
const REST: &str = "acceleration-noise-density";
const VIBRATION: &str = "vibration-noise-density";

/// A car, and a person who may not lift it or may interrupt.
struct OnStand {
    bench: VirtualBench,
    on_stand: bool,
    /// The operator interrupts this long after the wheels have begun to turn, in s.
    interrupts_s: Option<f64>,
    turned_s: f64,
    fastest_m_s: f64,
    armed: u32,
}

impl Bench for OnStand {
    fn wait(&mut self, observed: &mut Vec<Observation>) -> Result<(), Interrupted> {
        let from = observed.len();
        self.bench.wait(observed)?;
        for observation in observed.iter().skip(from) {
            if let Observation::Board(board) = observation {
                self.fastest_m_s = self.fastest_m_s.max(board.motor_speed.abs());
                self.turned_s += if board.motor_speed > 0.2 { 0.01 } else { 0.0 };
            }
        }
        match self.interrupts_s {
            Some(limit) if self.turned_s > limit => Err(Interrupted::ByOperator),
            _ => Ok(()),
        }
    }

    fn ask(&mut self, question: &Question) -> Result<Answer, Interrupted> {
        if question.id == "on-stand" && !self.on_stand {
            return Ok(Answer::YesNo(false));
        }
        self.bench.ask(question)
    }

    fn show(&mut self, text: &str, done: f64) {
        self.bench.show(text, done);
    }

    fn arm(&mut self, attendance: Attendance) -> Result<(), Refused> {
        assert_eq!(attendance, Attendance::Jog);
        self.armed += 1;
        self.bench.arm(attendance)
    }

    fn jog(&mut self, jog: Jog) -> Result<(), Refused> {
        self.bench.jog(jog)
    }

    fn drive(&mut self, _: Velocity, _: Option<Position>) -> Result<(), Refused> {
        panic!("the doctor does not drive");
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

/// A car that shakes as it is told: deviations of acceleration and yaw rate, always and per speed.
fn shaken(seed: u64, [a, a_per_speed, w, w_per_speed]: [f64; 4]) -> OnboardCar {
    let mut car = OnboardCar::planted(seed, None);
    let imu = &mut car.simulation.car.imu;
    (imu.vibration_m_s2, imu.vibration_m_s2_per_m_s) = (a, a_per_speed);
    (imu.vibration_rad_s, imu.vibration_rad_s_per_m_s) = (w, w_per_speed);
    // As measured by the doctor before.
    let pulse_um = car.simulation.car.motor_sensor.pulse_distance_um;
    car.file["board"]["speed"]["pulse_distance_um"] = value(pulse_um.round() as i64);
    car
}

fn on_stand(car: &OnboardCar) -> OnStand {
    OnStand {
        bench: VirtualBench::new(car).unwrap(),
        on_stand: true,
        interrupts_s: None,
        turned_s: 0.0,
        fastest_m_s: 0.0,
        armed: 0,
    }
}

fn measured(finding: &Finding, name: &str) -> f64 {
    let mut parameters = finding.parameters.iter();
    let parameter = parameters.find(|one| one.name == name);
    parameter
        .unwrap_or_else(|| panic!("{finding:?}"))
        .estimate
        .value
}

fn keys(finding: &Finding) -> Vec<&str> {
    let parameters = finding.parameters.iter();
    parameters
        .filter(|one| one.key.is_some())
        .map(|one| one.name.as_ref())
        .collect()
}

/// Ticks until a stopped car stands and its board is at neutral.
fn assert_neutral(bench: &mut OnStand, seed: u64) {
    bench.interrupts_s = None;
    let mut observed = Vec::new();
    for _ in 0..500 {
        bench.wait(&mut observed).unwrap();
    }
    let last = observed.iter().rev().find_map(|one| match one {
        Observation::Board(board) => Some(*board),
        _ => None,
    });
    let last = last.unwrap();
    assert!(
        matches!(last.mode, BoardMode::Neutral | BoardMode::Failsafe),
        "{seed}: {last:?}"
    );
    assert_eq!(last.motor_speed, 0.0, "{seed}: {last:?}");
}

/// Within 20 %. A sample of each 10 ms has independent noise of deviation s: a density of
/// s sqrt(0.01 s).
#[test]
fn the_measured_vibration_is_the_true_one() {
    for seed in 0..4 {
        let car = shaken(seed, [0.0, 3.0, 0.0, 0.12]);
        let mut bench = on_stand(&car);
        let findings = run(&doctor::STAND_STEPS, &mut bench, &mut NoJournal).unwrap();
        let finding = findings.first().unwrap();
        assert_eq!(finding.verdict, Verdict::Warning, "{seed}: {finding:?}");
        let vibration = measured(finding, VIBRATION);
        assert!((vibration / 0.3 - 1.0).abs() < 0.2, "{seed}: {finding:?}");
        let imu = &car.simulation.car.imu;
        // At the largest speed.
        let gyro = 0.1 * imu.gyro_noise_rad_s.hypot(0.12 * bench.fastest_m_s);
        assert!(
            (measured(finding, GYRO) / gyro - 1.0).abs() < 0.2,
            "{seed}: {finding:?}"
        );
        assert!(
            (0.7..1.0).contains(&bench.fastest_m_s),
            "{seed}: {}",
            bench.fastest_m_s
        );
        // Named, with both values, and in force.
        let estimator = bench.configuration().estimator;
        let believed = estimator.vibration_noise_density_m_s2_per_sqrt_hz_per_m_s;
        let name = "vibration_noise_density_m_s2_per_sqrt_hz_per_m_s is 0.100, measured";
        assert!(finding.found.contains(name), "{seed}: {finding:?}");
        assert!(
            (vibration..1.1 * vibration).contains(&believed),
            "{seed}: {believed}"
        );
        assert!(
            estimator.gyro_noise_density_rad_s_per_sqrt_hz >= measured(finding, GYRO),
            "{seed}"
        );
        assert_neutral(&mut bench, seed);
    }
}

#[test]
fn a_quiet_car_keeps_its_configuration() {
    let car = shaken(5, [0.0, 0.3, 0.0, 0.01]);
    let mut bench = on_stand(&car);
    let before = bench.configuration().clone();
    let findings = run(&doctor::STAND_STEPS, &mut bench, &mut NoJournal).unwrap();
    let finding = findings.first().unwrap();
    assert!(keys(finding).is_empty(), "{finding:?}");
    assert_eq!(*bench.configuration(), before);
    assert!(measured(finding, REST) < 0.02, "{finding:?}");
}

#[test]
fn a_car_that_is_not_on_a_stand_is_not_armed() {
    let mut bench = on_stand(&shaken(1, [0.0, 3.0, 0.0, 0.1]));
    bench.on_stand = false;
    let findings = run(&doctor::STAND_STEPS, &mut bench, &mut NoJournal).unwrap();
    let finding = findings.first().unwrap();
    assert_eq!(finding.verdict, Verdict::Failed, "{finding:?}");
    assert_eq!((bench.armed, bench.fastest_m_s), (0, 0.0));
}

#[test]
fn an_interruption_at_any_speed_ends_at_neutral() {
    for (seed, after_s) in [(2, 0.1), (2, 3.0), (3, 9.0), (3, 25.0)] {
        let mut bench = on_stand(&shaken(seed, [0.0, 1.0, 0.0, 0.0]));
        bench.interrupts_s = Some(after_s);
        let result = run(&doctor::STAND_STEPS, &mut bench, &mut NoJournal);
        assert!(result.is_err(), "{seed} {after_s}: {result:?}");
        assert_neutral(&mut bench, seed);
    }
}

/// A person who says that the car is on its stand and leaves it on the floor.
struct OnTheFloor {
    bench: VirtualBench,
    emergency_stops: u32,
    /// The farthest that the cameras saw it from where it stood, m.
    farthest_m: f64,
    place: Option<[f64; 2]>,
}

impl Bench for OnTheFloor {
    fn wait(&mut self, observed: &mut Vec<Observation>) -> Result<(), Interrupted> {
        let from = observed.len();
        self.bench.wait(observed)?;
        for observation in observed.iter().skip(from) {
            if let Observation::Pose(pose) = observation {
                let [x, y, _] = pose.position;
                let [from_x, from_y] = *self.place.get_or_insert([x, y]);
                self.farthest_m = self.farthest_m.max((x - from_x).hypot(y - from_y));
            }
        }
        Ok(())
    }

    fn ask(&mut self, question: &Question) -> Result<Answer, Interrupted> {
        if question.id == "on-stand" {
            return Ok(Answer::YesNo(true));
        }
        self.bench.ask(question)
    }

    fn show(&mut self, text: &str, done: f64) {
        self.bench.show(text, done);
    }

    fn arm(&mut self, attendance: Attendance) -> Result<(), Refused> {
        self.bench.arm(attendance)
    }

    fn jog(&mut self, jog: Jog) -> Result<(), Refused> {
        self.bench.jog(jog)
    }

    fn drive(&mut self, velocity: Velocity, position: Option<Position>) -> Result<(), Refused> {
        self.bench.drive(velocity, position)
    }

    fn disarm(&mut self) -> Result<(), Refused> {
        self.bench.disarm()
    }

    fn emergency_stop(&mut self) -> Result<(), Refused> {
        self.emergency_stops += 1;
        self.bench.emergency_stop()
    }

    fn configuration(&self) -> &Config {
        self.bench.configuration()
    }

    fn change(&mut self, values: &[(&str, toml_edit::Value)]) -> Result<(), Refused> {
        self.bench.change(values)
    }
}
