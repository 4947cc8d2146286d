//! Procedures whose process is killed in the middle of a step: the car stops, the configuration is
//! as it was, and the procedure goes on with that step.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use singletrack_commissioning::{
    Answer, Attendance, Bench, Finding, Interrupted, Jog, Journal, Observation, Question, Refused,
    Step, Verdict, bring_up, calibrate, doctor, run,
};
use singletrack_control::{Position, Velocity};
use singletrack_core::Config;
use singletrack_onboard::{OnboardCar, VirtualBench};
use singletrack_sim::{SimulationConfig, Truth};
use toml_edit::{DocumentMut, Value};

/// What was found before, as the journal of the command line keeps it.
#[derive(Default)]
struct Kept {
    findings: Vec<Finding>,
    begun: Vec<&'static str>,
}

impl Journal for Kept {
    fn found(&self, step: &str) -> Option<Finding> {
        let mut findings = self.findings.iter();
        findings.find(|finding| finding.step == step).cloned()
    }

    fn keep(&mut self, finding: &Finding) -> Result<(), Interrupted> {
        self.findings.push(finding.clone());
        Ok(())
    }

    fn begin(&mut self, step: &Step, _: usize, _: usize) {
        self.begun.push(step.name);
    }
}

/// A process that is killed as soon as `when` holds of the true car: from then on it does nothing.
struct Mortal<'a> {
    bench: &'a mut VirtualBench,
    /// The questions so far.
    asked: Vec<&'static str>,
    when: fn(&Truth, &[&str]) -> bool,
    is_dead: bool,
}

impl Mortal<'_> {
    fn lives(&self) -> Result<(), Refused> {
        match self.is_dead {
            true => Err(Refused("killed".to_owned())),
            false => Ok(()),
        }
    }
}

impl Bench for Mortal<'_> {
    fn wait(&mut self, observed: &mut Vec<Observation>) -> Result<(), Interrupted> {
        self.is_dead |= (self.when)(&self.bench.drive_of_host().world.truth(), &self.asked);
        if self.is_dead {
            return Err(Interrupted::ByOperator);
        }
        self.bench.wait(observed)
    }

    fn ask(&mut self, question: &Question) -> Result<Answer, Interrupted> {
        self.asked.push(question.id);
        self.bench.ask(question)
    }

    fn show(&mut self, _: &str, _: f64) {}

    fn arm(&mut self, attendance: Attendance) -> Result<(), Refused> {
        self.lives()?;
        self.bench.arm(attendance)
    }

    fn jog(&mut self, jog: Jog) -> Result<(), Refused> {
        self.lives()?;
        self.bench.jog(jog)
    }

    fn drive(&mut self, velocity: Velocity, position: Option<Position>) -> Result<(), Refused> {
        self.lives()?;
        self.bench.drive(velocity, position)
    }

    fn disarm(&mut self) -> Result<(), Refused> {
        self.lives()?;
        self.bench.disarm()
    }

    fn emergency_stop(&mut self) -> Result<(), Refused> {
        self.lives()?;
        self.bench.emergency_stop()
    }

    fn configuration(&self) -> &Config {
        self.bench.configuration()
    }

    fn change(&mut self, values: &[(&str, Value)]) -> Result<(), Refused> {
        self.lives()?;
        self.bench.change(values)
    }
}

/// The simulated car as the example describes it, in a hall.
fn known_car() -> OnboardCar {
    let mut file: DocumentMut = include_str!("../../../host/daemon/singletrackd.example.toml")
        .parse()
        .unwrap();
    let corners = "[[-3.5, -3.0], [3.5, -3.0], [3.5, 3.0], [-3.5, 3.0]]";
    file["serial"]["port"] = toml_edit::value("simulated");
    file["motion_capture"]["server"] = toml_edit::value("127.0.0.1");
    file["fence"]["corners_m"] = toml_edit::value(corners.parse::<Value>().unwrap());
    file["fence"]["braking_m_s2"] = toml_edit::value(0.6);
    OnboardCar {
        seed: 1,
        simulation: SimulationConfig::default(),
        file,
        fault: None,
    }
}

/// Kills a procedure, lets `seconds` pass, and runs it to its end. Gives the true car at the kill
/// and after that time, and the way between them in m.
fn killed_and_resumed(
    bench: &mut VirtualBench,
    steps: &[Step],
    step: &str,
    when: fn(&Truth, &[&str]) -> bool,
    seconds: f64,
) -> [Truth; 2] {
    let mut journal = Kept::default();
    let mut mortal = Mortal {
        bench: &mut *bench,
        asked: Vec::new(),
        when,
        is_dead: false,
    };
    let result = run(steps, &mut mortal, &mut journal);
    assert!(
        result.is_err() && mortal.is_dead,
        "{:?}",
        result.map(|_| ())
    );
    let file = bench.file().to_owned();
    let killed = bench.drive_of_host().world.truth();
    bench.lose_operator();
    let begun = bench.seconds();
    let mut unseen = Vec::new();
    while bench.seconds() < begun + seconds {
        bench.wait(&mut unseen).unwrap();
    }
    let stopped = bench.drive_of_host().world.truth();
    assert_eq!(bench.file(), file);
    assert_eq!(journal.begun.last(), Some(&step));

    let done = journal.begun.len() - 1;
    journal.begun.clear();
    let findings = run(steps, bench, &mut journal).unwrap();
    assert_eq!(journal.begun.len(), steps.len() - done);
    assert_eq!(journal.begun.first(), Some(&step));
    for finding in findings {
        assert_ne!(
            finding.verdict,
            Verdict::Failed,
            "{}: {}",
            finding.step,
            finding.found
        );
    }
    assert_eq!(bench.guard().violations(), []);
    [killed, stopped]
}

fn steps(all: &[Step], names: &[&str]) -> Vec<Step> {
    let named = |step: &&Step| names.contains(&step.name);
    all.iter().filter(named).copied().collect()
}

#[test]
fn a_doctor_that_is_killed_while_the_car_is_pushed_is_resumed_there() {
    let mut bench = VirtualBench::new(&known_car()).unwrap();
    let [killed, _] = killed_and_resumed(
        &mut bench,
        &steps(&doctor::STEPS, &["board", "cameras"]),
        "cameras",
        |truth, asked| asked.contains(&"push-forward") && truth.wheel_speed > 0.2,
        5.0,
    );
    assert!(killed.wheel_speed > 0.2);
}

#[test]
fn a_bring_up_that_is_killed_while_it_jogs_stops_within_0_3_s_and_is_resumed_there() {
    let mut bench = VirtualBench::new(&known_car()).unwrap();
    let steps = steps(
        bring_up::STEPS,
        &[
            "stand",
            "servo-direction",
            "motor-direction",
            "stop-silence",
        ],
    );
    let [killed, stopped] = killed_and_resumed(
        &mut bench,
        &steps,
        "motor-direction",
        |truth, _| truth.wheel_speed > 0.3,
        0.3,
    );
    // The motor has let go: the wheels only roll out.
    assert!(killed.wheel_speed > 0.3);
    assert!(
        stopped.wheel_speed < killed.wheel_speed - 0.05,
        "{stopped:?}"
    );
}

#[test]
fn a_calibration_that_is_killed_while_it_drives_stands_within_1_5_s_and_is_resumed_there() {
    let mut bench = VirtualBench::new(&known_car()).unwrap();
    let [killed, stopped] = killed_and_resumed(
        &mut bench,
        &steps(&calibrate::STEPS, &["straight"]),
        "straight",
        |truth, _| truth.speed > 0.25 && !truth.held,
        1.5,
    );
    assert!(killed.speed > 0.25);
    assert!(stopped.speed.abs() < 0.01, "{stopped:?}");
    assert!(
        stopped.way - killed.way < 0.2,
        "{}",
        stopped.way - killed.way
    );
}
