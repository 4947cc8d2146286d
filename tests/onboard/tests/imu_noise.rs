//! The noise of the IMU with the wheels turning on a stand, against what is true of it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_commissioning::{
    Answer, Attendance, Bench, Finding, Interrupted, Jog, Live, Observation, Question, Refused,
    Verdict, doctor, run,
};
use singletrack_control::{Position, Velocity};
use singletrack_core::Config;
use singletrack_onboard::{NoJournal, OnboardCar, VirtualBench};
use singletrack_protocol::BoardMode;
use toml_edit::value;

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

    fn show(&mut self, live: &Live<'_>) {
        self.bench.show(live);
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
