//! Cars through the three procedures, one after the other, and the paper's circle, to compare what
//! a configuration makes of a car.

use core::{
    f64::consts::TAU,
    fmt::{self, Write as _},
};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    thread,
};

use singletrack_commissioning::{Bench as _, Finding, Interval, Verdict, run};
use singletrack_core::{
    Config,
    config::{OuterLoopSection, ReferenceSection, Start},
};
use singletrack_pilot::{Arming, Mode, PilotRequest, Reason};
use singletrack_scenario::virtual_drive::VirtualDrive;
use singletrack_sim::{BoardKind, StartPose};

use crate::{
    bench::{NoJournal, VirtualBench, procedures},
    car::{OnboardCar, PlantedFault, truth_of},
};

/// A parameter of a car, as it was measured last.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// What is true; none if the campaign does not know.
    pub truth: Option<f64>,
    /// What was measured.
    pub estimate: Interval,
}

/// What became of a car.
#[derive(Clone, Debug)]
pub struct CarOutcome {
    /// Its seed.
    pub seed: u64,
    /// What was planted.
    pub fault: Option<PlantedFault>,
    /// Whether that was found in time.
    pub found: bool,
    /// Whether all procedures passed.
    pub passed: bool,
    /// The findings, with the procedure's name.
    pub findings: Vec<(&'static str, Finding)>,
    /// What was measured.
    pub measured: Vec<Measured>,
    /// What must never happen.
    pub violations: Vec<String>,
    /// Questions without a script.
    pub unknown: BTreeMap<String, u32>,
    /// The circle with the configuration that the owner began with, and with that of the
    /// procedures.
    pub circles: [Option<Circle>; 2],
    /// Time that the procedures took, in s.
    pub seconds: f64,
    /// Why the car could not be simulated.
    pub error: Option<String>,
}

/// The way on the floor within which a fault must be found, in m.
const FOUND_WITHIN_M: f64 = 0.5;

/// Takes a car through the procedures, and drives the circle with it.
pub fn onboard(car: &OnboardCar) -> CarOutcome {
    onboard_until(car, false)
}

/// [`onboard`] that with `found` goes only until what was planted has been found.
pub fn onboard_until(car: &OnboardCar, found: bool) -> CarOutcome {
    let mut outcome = CarOutcome {
        seed: car.seed,
        fault: car.fault,
        found: false,
        passed: false,
        findings: Vec::new(),
        measured: Vec::new(),
        violations: Vec::new(),
        unknown: BTreeMap::new(),
        circles: [None, None],
        seconds: 0.0,
        error: None,
    };
    if let Err(error) = try_onboard(car, found, &mut outcome) {
        outcome.error = Some(error);
    }
    outcome
}

fn try_onboard(car: &OnboardCar, found: bool, outcome: &mut CarOutcome) -> Result<(), String> {
    let text = |error: &dyn fmt::Display| error.to_string();
    let mut bench = VirtualBench::new(car).map_err(|error| text(&error))?;
    let mut measured: BTreeMap<String, Measured> = BTreeMap::new();
    let mut failed = false;
    'car: for procedure in procedures() {
        for step in &procedure.steps {
            let before_m = bench.drive_of_host().world.truth().way;
            bench.guard_mut().begin_step();
            let findings = run(core::slice::from_ref(step), &mut bench, &mut NoJournal)
                .map_err(|error| text(&error))?;
            let world = &bench.drive_of_host().world;
            for finding in findings {
                for parameter in &finding.parameters {
                    let mut m = Measured {
                        name: parameter.name.to_string(),
                        unit: parameter.unit.to_string(),
                        truth: match parameter.name.as_ref() {
                            "gyro-bias" => Some(bench.guard().gyro_bias(bench.configuration())),
                            name => truth_of(name, procedure.name, world),
                        },
                        estimate: parameter.estimate,
                    };
                    if parameter.name == "body-yaw"
                        && let Some(truth) = &mut m.truth
                    {
                        // The same angle, on the side of the estimate.
                        *truth = m.estimate.value + libm::remainder(*truth - m.estimate.value, TAU);
                    }
                    measured.insert(m.name.clone(), m);
                }
                let is_failed = finding.verdict == Verdict::Failed;
                failed |= is_failed;
                if is_failed && outcome.fault.is_some() && !outcome.found {
                    outcome.found = before_m < FOUND_WITHIN_M && world.truth().way < FOUND_WITHIN_M;
                }
                outcome.findings.push((procedure.name, finding));
            }
            let way_m = bench.drive_of_host().world.truth().way;
            if is_corrected(car, bench.configuration()) && way_m < FOUND_WITHIN_M {
                outcome.found = true;
            }
            if (failed && step.essential) || (found && outcome.found) {
                bench.end_procedure();
                failed = true;
                break 'car;
            }
        }
        bench.end_procedure();
        if failed {
            break;
        }
    }
    outcome.passed = !failed;
    outcome.seconds = bench.seconds();
    outcome.measured = measured.into_values().collect();
    outcome.unknown.clone_from(bench.unknown_questions());
    outcome.violations = bench
        .guard()
        .violations()
        .iter()
        .map(|violation| format!("{:.1} s: {}", violation.at_s, violation.what))
        .collect();
    if outcome.passed {
        outcome.circles = [drive(car, &car.file.to_string()), drive(car, bench.file())];
    }
    Ok(())
}

/// Whether a procedure has put right what was planted in the configuration of this car.
fn is_corrected(car: &OnboardCar, config: &Config) -> bool {
    match car.fault {
        Some(PlantedFault::ImuUpsideDown) => {
            let up = config.board_configuration().imu_axes.up;
            up.index() == 2 && up.is_negative()
        }
        Some(PlantedFault::WrongSign) => {
            let truly = car.simulation.car.servo.gain_us_per_rad;
            f64::from(config.board.servo.gain_us_per_rad) * truly > 0.0
        }
        Some(PlantedFault::SwappedWires | PlantedFault::WrongBody | PlantedFault::DeadKill)
        | None => false,
    }
}

impl CarOutcome {
    /// What became of the car, for people.
    pub fn text(&self, verbose: bool) -> String {
        let mut text = String::new();
        let fault = self.fault.map_or(String::new(), |fault| {
            format!(
                ", {fault} {}",
                if self.found { "found" } else { "NOT FOUND" }
            )
        });
        let _ = writeln!(
            text,
            "car {}: {}{fault}, {} of {} intervals hold the truth, {:.0} s",
            self.seed,
            if self.passed { "passed" } else { "not passed" },
            self.holding(),
            self.known(),
            self.seconds,
        );
        if let Some(error) = &self.error {
            let _ = writeln!(text, "  {error}");
        }
        for (procedure, finding) in &self.findings {
            if verbose || finding.verdict == Verdict::Failed {
                let _ = writeln!(
                    text,
                    "  {procedure} {}: {}: {}",
                    finding.step,
                    finding.verdict.name(),
                    finding.found.replace('\n', "; "),
                );
            }
        }
        for m in &self.measured {
            if verbose || !m.holds() {
                let _ = writeln!(
                    text,
                    "  {} {}: {:.4} [{:.4}, {:.4}], truly {}",
                    m.name,
                    m.unit,
                    m.estimate.value,
                    m.estimate.low,
                    m.estimate.high,
                    m.truth
                        .map_or("unknown".into(), |truth| format!("{truth:.4}")),
                );
            }
        }
        for violation in &self.violations {
            let _ = writeln!(text, "  VIOLATION at {violation}");
        }
        for (question, count) in &self.unknown {
            let _ = writeln!(text, "  no script for question {question} ({count} times)");
        }
        if let [before, Some(after)] = &self.circles {
            let before = before.as_ref().map_or("not driven".into(), Circle::text);
            let _ = writeln!(text, "  circle before: {before}; after: {}", after.text());
        }
        text
    }

    fn known(&self) -> usize {
        self.measured.iter().filter(|m| m.truth.is_some()).count()
    }

    fn holding(&self) -> usize {
        let known = self.measured.iter().filter(|m| m.truth.is_some());
        known.filter(|m| m.holds()).count()
    }
}

impl Measured {
    /// Whether the interval holds the truth.
    pub fn holds(&self) -> bool {
        self.truth
            .is_some_and(|truth| self.estimate.contains(truth))
    }
}

/// Cars with consecutive seeds.
#[derive(Clone, Copy, Debug)]
pub struct Campaign {
    /// The first seed.
    pub first_seed: u64,
    /// The number of cars.
    pub count: u64,
    /// The board.
    pub board: BoardKind,
    /// The number of threads.
    pub threads: usize,
}

/// Why the results could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", path.display())]
pub struct CampaignError {
    path: PathBuf,
    source: std::io::Error,
}

impl Campaign {
    /// Takes all cars through the procedures; `each` gets them in the order of their end.
    /// Returns them in the order of their seeds.
    pub fn run(&self, each: impl Fn(&CarOutcome) + Sync) -> Vec<CarOutcome> {
        let next = AtomicU64::new(0);
        let cars = Mutex::new(Vec::new());
        thread::scope(|scope| {
            for _ in 0..self.threads.clamp(1, 64) {
                scope.spawn(|| {
                    loop {
                        let number = next.fetch_add(1, Ordering::Relaxed);
                        if number >= self.count {
                            return;
                        }
                        let mut car = OnboardCar::random(self.first_seed + number);
                        car.simulation.board.kind = self.board;
                        let outcome = onboard(&car);
                        let mut cars = cars.lock().unwrap_or_else(PoisonError::into_inner);
                        each(&outcome);
                        cars.push(outcome);
                    }
                });
            }
        });
        let mut cars = cars.into_inner().unwrap_or_else(PoisonError::into_inner);
        cars.sort_by_key(|car| car.seed);
        cars
    }
}

/// Writes a row per car and parameter.
///
/// # Errors
///
/// The file can't be written.
pub fn write_csv(path: &Path, cars: &[CarOutcome]) -> Result<(), CampaignError> {
    let mut text = String::from("seed,parameter,unit,truth,estimate,low,high\n");
    for car in cars {
        for m in &car.measured {
            let Interval { value, low, high } = m.estimate;
            if let Some(truth) = m.truth {
                let _ = writeln!(
                    text,
                    "{},{},{},{truth},{value},{low},{high}",
                    car.seed, m.name, m.unit
                );
            }
        }
    }
    fs::write(path, text).map_err(|source| CampaignError {
        path: path.to_owned(),
        source,
    })
}

/// What the cars come to.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    cars: usize,
    passed: usize,
    /// For each parameter: intervals, and those that hold the truth.
    parameters: BTreeMap<String, [usize; 2]>,
    faults: [usize; 2],
    violations: usize,
    /// Errors of P on the circle, before and after, in m, of the cars that drove both times.
    circles: Vec<[f64; 2]>,
    /// Cars that did not end the circle with the configuration of their owner.
    not_driven_before: usize,
    not_driven_after: usize,
    errors: usize,
}

impl Summary {
    /// Summary of these cars.
    pub fn of(cars: &[CarOutcome]) -> Self {
        let mut summary = Self {
            cars: cars.len(),
            ..Self::default()
        };
        for car in cars {
            summary.passed += usize::from(car.passed);
            summary.violations += car.violations.len();
            summary.errors += usize::from(car.error.is_some());
            if car.fault.is_some() {
                summary.faults[0] += 1;
                summary.faults[1] += usize::from(car.found);
            }
            for m in car.measured.iter().filter(|m| m.truth.is_some()) {
                let counts = summary.parameters.entry(m.name.clone()).or_default();
                counts[0] += 1;
                counts[1] += usize::from(m.holds());
            }
            let error = |circle: &Option<Circle>| circle.as_ref().and_then(|c| c.error_m);
            if let [before, after @ Some(_)] = &car.circles {
                match (error(before), error(after)) {
                    (Some(before), Some(after)) => summary.circles.push([before, after]),
                    (None, Some(_)) => summary.not_driven_before += 1,
                    (_, None) => summary.not_driven_after += 1,
                }
            }
        }
        summary
    }

    /// Whether nothing happened that must not, and every planted fault was found.
    pub const fn is_good(&self) -> bool {
        self.violations == 0 && self.errors == 0 && self.faults[0] == self.faults[1]
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, [all, holding]) in &self.parameters {
            let share = 100.0 * *holding as f64 / *all as f64;
            writeln!(f, "{name}: {holding} of {all} ({share:.0} %)")?;
        }
        writeln!(f, "{} of {} cars passed", self.passed, self.cars)?;
        let median = |side: usize| {
            let mut errors: Vec<f64> = self.circles.iter().map(|pair| pair[side]).collect();
            errors.sort_by(f64::total_cmp);
            errors.get(errors.len() / 2).map_or(f64::NAN, |m| m * 1e3)
        };
        writeln!(
            f,
            "circle: median error of P {:.1} mm before, {:.1} mm after ({} cars); \
             not driven to its end: {} before, {} after",
            median(0),
            median(1),
            self.circles.len(),
            self.not_driven_before,
            self.not_driven_after,
        )?;
        let (all, holding) = self
            .parameters
            .values()
            .fold((0, 0), |(all, holding), [a, h]| (all + a, holding + h));
        writeln!(
            f,
            "{} cars: {holding} of {all} intervals hold the truth, {} of {} planted faults \
             found, {} violations",
            self.cars, self.faults[1], self.faults[0], self.violations
        )
    }
}

/// A drive along the circle.
#[derive(Clone, Debug)]
pub struct Circle {
    /// Root mean square of the true distance of P from its reference, in m; none if the drive
    /// did not last.
    pub error_m: Option<f64>,
    /// Why it ended early.
    pub ended: Option<&'static str>,
}

/// Radius of the circle, in m, and its angular velocity, in rad/s.
const RADIUS_M: f64 = 1.0;
const RATE_RAD_S: f64 = 0.6;
/// Duration of the drive, and the part of it before P has settled, in s.
const DRIVE_S: f64 = 25.0;
const SETTLED_S: f64 = 10.0;
/// Time for the start, in s.
const START_S: f64 = 12.0;

/// Drives the circle with this file; none if it is refused.
pub(crate) fn drive(car: &OnboardCar, file: &str) -> Option<Circle> {
    let mut config = Config::from_toml(file).ok()?;
    config.reference = ReferenceSection::Circle {
        radius_m: RADIUS_M,
        angular_velocity_rad_s: RATE_RAD_S,
        centre_m: [0.0; 2],
        start: Start::Beginning,
    };
    config.outer_loop = OuterLoopSection::Proportional {
        gain_per_s: [1.0; 2],
        feed_forward: true,
    };
    config.supervisor.prove_first_metre = false;
    let p = config.law.point_distance_m;
    let front = car.simulation.car.vehicle.front_axle_distance_m;
    let mut simulation = car.simulation.clone();
    simulation.car.start = StartPose {
        x_m: RADIUS_M,
        y_m: -p - front,
        yaw_rad: core::f64::consts::FRAC_PI_2,
    };
    let mut drive = VirtualDrive::new(config, car.seed, simulation).ok()?;
    let mut circle = Circle {
        error_m: None,
        ended: None,
    };
    let (mut armed, mut driven) = (false, false);
    let (mut sum, mut count) = (0.0, 0_u32);
    loop {
        let now_s = drive.next_tick_us() as f64 * 1e-6;
        if !armed && drive.mode() == Mode::Ready {
            armed = drive.request(PilotRequest::Arm(Arming::Unattended)).is_ok();
        }
        let tick = drive.step();
        let output = &tick.tick.output;
        let Some(time) = output.drive_time else {
            if driven || now_s > START_S {
                let reason = output.reason.or(output.preflight);
                circle.ended = Some(reason.map_or("not-started", Reason::name));
                return Some(circle);
            }
            continue;
        };
        driven = true;
        if time > SETTLED_S
            && let Some(wanted) = output.reference.and_then(|reference| reference.position)
        {
            let [x, y] = tick.truth.point_p(front, p);
            sum += (x - wanted.x).powi(2) + (y - wanted.y).powi(2);
            count += 1;
        }
        if time > DRIVE_S {
            circle.error_m = Some(libm::sqrt(sum / f64::from(count.max(1))));
            return Some(circle);
        }
    }
}

impl Circle {
    /// In words.
    pub fn text(&self) -> String {
        match (self.error_m, self.ended) {
            (Some(error), _) => format!("{:.1} mm", error * 1e3),
            (None, Some(reason)) => format!("ended: {reason}"),
            (None, None) => "not driven".into(),
        }
    }
}
