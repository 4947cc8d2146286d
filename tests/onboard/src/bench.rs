//! A simulated car, the daemon's host in virtual time, and a person beside them; the procedures.

use std::collections::BTreeMap;

use singletrack_commissioning::{
    Answer, Attendance, Bench, Finding, Interrupted, Jog, Journal, Observation, Question, Refused,
    Step, Verdict, bring_up, calibrate, doctor,
    edit::{Edit, EditError},
    run,
};
use singletrack_control::{Position, Setpoint, Time, Velocity};
use singletrack_core::{Config, ConfigError, config::ReferenceSection};
use singletrack_pilot::{Arming, PilotRequest, Reason};
use singletrack_record::{Entry, LinkPhase};
use singletrack_scenario::virtual_drive::{VirtualDrive, VirtualDriveError};
use toml_edit::Value;

use crate::{car::OnboardCar, guard::Guard, person::Person};

/// A procedure with its steps.
pub(crate) struct Procedure {
    pub(crate) name: &'static str,
    pub(crate) steps: Vec<Step>,
}

/// The procedures, in their order.
pub(crate) fn procedures() -> Vec<Procedure> {
    let procedure = |name, steps: &[Step]| Procedure {
        name,
        steps: steps.to_vec(),
    };
    vec![
        procedure("doctor", &doctor::STEPS),
        procedure("bring-up", bring_up::STEPS),
        procedure("calibrate", &calibrate::STEPS),
    ]
}

/// A journal that keeps nothing: every step is run.
#[derive(Debug, Default)]
pub struct NoJournal;

impl Journal for NoJournal {
    fn found(&self, _: &str) -> Option<Finding> {
        None
    }

    fn keep(&mut self, _: &Finding) -> Result<(), Interrupted> {
        Ok(())
    }

    fn begin(&mut self, _: &Step, _: usize, _: usize) {}
}

/// Why there is no such bench.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The owner's file is refused.
    #[error("the configuration: {0}")]
    Config(#[from] ConfigError),
    /// The owner's file is no TOML.
    #[error(transparent)]
    File(#[from] EditError),
    /// The simulation can't be set up.
    #[error(transparent)]
    Drive(#[from] VirtualDriveError),
}

/// How often a held drive is renewed, in ticks.
const RENEW_TICKS: u64 = 10;
/// The daemon answers a request within, in ticks.
const ANSWER_TICKS: u32 = 300;
/// How long the operator waits for a car that is not ready to drive, in ticks.
const PATIENCE_TICKS: u32 = 500;
/// How long set-points of a drive last, in ms.
const SETPOINT_TIMEOUT_MS: u32 = 200;

/// A simulated car with its host, and scripted hands.
#[derive(Debug)]
pub struct VirtualBench {
    drive: VirtualDrive,
    file: Edit,
    config: Config,
    person: Person,
    guard: Guard,
    /// The drive that the connection of the operator holds.
    held: bool,
    /// The reference in force is another than that of the file.
    has_reference: bool,
    ticks: u64,
    /// Why an arm request would be refused now.
    preflight: Option<Reason>,
    link_is_ready: bool,
    /// Questions that nobody could answer, and how often.
    unknown: BTreeMap<String, u32>,
    /// Every question, once.
    questions: Vec<Question>,
    /// Every change of the configuration.
    changes: Vec<(String, Value)>,
}

impl VirtualBench {
    /// Switches everything on and waits until the daemon has the board.
    ///
    /// # Errors
    ///
    /// The owner's configuration or the simulation is refused.
    pub fn new(car: &OnboardCar) -> Result<Self, BenchError> {
        let config = car.configuration()?;
        let mut drive = VirtualDrive::new(config.clone(), car.seed, car.simulation.clone())?;
        drive.keep_entries();
        let mut bench = Self {
            drive,
            file: Edit::new(&car.file.to_string())?,
            guard: Guard::new(&config),
            config,
            person: Person::new(car.seed),
            held: false,
            has_reference: false,
            ticks: 0,
            preflight: None,
            link_is_ready: false,
            unknown: BTreeMap::new(),
            questions: Vec::new(),
            changes: Vec::new(),
        };
        let mut observed = Vec::new();
        for _ in 0..ANSWER_TICKS * 4 {
            bench.step(&mut observed);
            if bench.link_is_ready {
                break;
            }
        }
        Ok(bench)
    }

    /// The simulated car with its host.
    pub const fn drive_of_host(&self) -> &VirtualDrive {
        &self.drive
    }

    /// Mutable access, for faults.
    pub const fn drive_of_host_mut(&mut self) -> &mut VirtualDrive {
        &mut self.drive
    }

    /// The file of the configuration, as the procedures have left it.
    pub fn file(&self) -> &str {
        self.file.text()
    }

    /// What the campaign has watched.
    pub const fn guard(&self) -> &Guard {
        &self.guard
    }

    pub(crate) const fn guard_mut(&mut self) -> &mut Guard {
        &mut self.guard
    }

    /// Lets the car roll out, and looks whether it has come to its end: it stands, disarmed.
    pub fn end_procedure(&mut self) {
        self.pass(4.0);
        self.guard.end(&self.drive);
    }

    /// The connection of the operator ends, as when the program is killed.
    pub fn lose_operator(&mut self) {
        self.held = false;
        // It may hold nothing.
        let _ = self.drive.request(PilotRequest::OperatorGone);
    }

    /// Every question that was asked, once.
    pub fn questions(&self) -> &[Question] {
        &self.questions
    }

    /// Every value that was put into the configuration.
    pub fn changes(&self) -> &[(String, Value)] {
        &self.changes
    }

    /// The questions that were skipped because no script knows them.
    pub const fn unknown_questions(&self) -> &BTreeMap<String, u32> {
        &self.unknown
    }

    /// Time since the car was switched on, in s.
    pub fn seconds(&self) -> f64 {
        self.drive.world.now_us as f64 * 1e-6
    }

    /// One tick of the daemon. What was observed is appended.
    fn step(&mut self, observed: &mut Vec<Observation>) {
        if self.held && self.ticks.is_multiple_of(RENEW_TICKS) {
            let _ = self.drive.request(PilotRequest::Hold);
        }
        self.ticks += 1;
        let tick = self.drive.step();
        self.preflight = tick.tick.output.preflight;
        self.person.act(&mut *self.drive.world);
        self.guard.watch(&self.drive, &tick.truth);
        for entry in self.drive.entries() {
            self.observe(&entry, observed);
        }
    }

    /// The set-point of a car that stands: without one it can't be armed.
    fn stand_still(&self) {
        let now = Time(self.drive.now_us() * 1_000);
        self.drive
            .send_setpoint(&Setpoint::point(now, None, Velocity::zeros()));
    }

    fn observe(&mut self, entry: &Entry, observed: &mut Vec<Observation>) {
        if let Entry::Tick(tick) = entry {
            let ready = tick.link == LinkPhase::Ready;
            if ready != self.link_is_ready {
                self.link_is_ready = ready;
                observed.push(Observation::Link(ready));
            }
        }
        observed.extend(Observation::of(entry, &self.config.watch));
    }

    /// Lets time pass unobserved.
    fn pass(&mut self, seconds: f64) {
        let until = self.seconds() + seconds;
        let mut unseen = Vec::new();
        while self.seconds() < until {
            self.step(&mut unseen);
            unseen.clear();
        }
    }

    /// Why nothing is held any more.
    fn ended(&self) -> Refused {
        let reason = self.drive.controller().pilot.reason();
        Refused(
            reason
                .map_or("the car is not armed", Reason::name)
                .to_owned(),
        )
    }

    fn request(&self, request: PilotRequest) -> Result<(), Refused> {
        self.drive
            .request(request)
            .map_err(|error| Refused(error.to_string()))
    }

    /// Puts a configuration in force and waits until the board has it.
    fn put_in_force(&mut self, config: Config) -> Result<(), Refused> {
        self.drive
            .reconfigure(config)
            .map_err(|error| Refused(error.to_string()))?;
        let mut unseen = Vec::new();
        for _ in 0..ANSWER_TICKS {
            self.step(&mut unseen);
            if self.link_is_ready {
                return Ok(());
            }
        }
        Err(Refused("the board does not take the configuration".into()))
    }
}

impl Bench for VirtualBench {
    fn wait(&mut self, observed: &mut Vec<Observation>) -> Result<(), Interrupted> {
        self.step(observed);
        Ok(())
    }

    fn ask(&mut self, question: &Question) -> Result<Answer, Interrupted> {
        if !self.questions.contains(question) {
            self.questions.push(question.clone());
        }
        let Some(think_s) = self.person.consider(question, &*self.drive.world) else {
            *self.unknown.entry(question.id.to_string()).or_default() += 1;
            self.pass(1.0);
            return Ok(Answer::Skip);
        };
        // No action of the hands takes longer.
        for _ in 0..1_200 {
            if !self.person.is_busy(&*self.drive.world) {
                break;
            }
            self.pass(0.1);
        }
        self.pass(think_s);
        Ok(self.person.answer(question, &*self.drive.world))
    }

    fn show(&mut self, _: &str, _: f64) {}

    fn arm(&mut self, attendance: Attendance) -> Result<(), Refused> {
        if attendance == Attendance::Drive && !self.has_reference {
            self.put_in_force(Config {
                reference: ReferenceSection::External {
                    setpoint_timeout_ms: SETPOINT_TIMEOUT_MS,
                },
                ..self.config.clone()
            })?;
            self.has_reference = true;
        }
        let mut unseen = Vec::new();
        for _ in 0..PATIENCE_TICKS {
            // As the daemon does, which says why it does not.
            let waits = attendance == Attendance::Drive && self.preflight.is_some();
            if !waits {
                break;
            }
            self.stand_still();
            self.step(&mut unseen);
            unseen.clear();
        }
        self.stand_still();
        self.request(match attendance {
            Attendance::Jog => PilotRequest::Arm(Arming::Jog),
            Attendance::Drive => PilotRequest::Arm(Arming::Held),
        })?;
        self.step(&mut unseen);
        let mode = self.drive.mode();
        self.held = mode.is_underway();
        match self.held {
            true => Ok(()),
            false => Err(self.ended()),
        }
    }

    fn jog(&mut self, jog: Jog) -> Result<(), Refused> {
        if !self.held || !self.drive.mode().is_underway() {
            self.held = false;
            return Err(self.ended());
        }
        self.drive.host().parts.jogs.send(singletrack_pilot::Jog {
            servo_us: jog.servo_us,
            esc_us: jog.esc_us,
        });
        Ok(())
    }

    fn drive(&mut self, velocity: Velocity, position: Option<Position>) -> Result<(), Refused> {
        if !self.held || !self.drive.mode().is_underway() {
            self.held = false;
            return Err(self.ended());
        }
        let now = Time(self.drive.now_us() * 1_000);
        self.drive
            .send_setpoint(&Setpoint::point(now, position, velocity));
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), Refused> {
        self.request(PilotRequest::Disarm)
    }

    fn emergency_stop(&mut self) -> Result<(), Refused> {
        self.request(PilotRequest::EmergencyStop)
    }

    fn configuration(&self) -> &Config {
        &self.config
    }

    fn change(&mut self, values: &[(&str, Value)]) -> Result<(), Refused> {
        let mut file = self.file.clone();
        for (key, value) in values {
            file.set(key, value)
                .map_err(|error| Refused(error.to_string()))?;
        }
        if !file.is_changed() {
            return Ok(());
        }
        let config = Config::from_toml(file.text()).map_err(|error| Refused(error.to_string()))?;
        self.put_in_force(config.clone())?;
        self.has_reference = false;
        self.guard.configure(&config);
        self.config = config;
        self.file = file;
        let changes = values.iter();
        self.changes
            .extend(changes.map(|(key, value)| ((*key).to_owned(), value.clone())));
        Ok(())
    }
}

/// What a step came to.
#[derive(Clone, Debug)]
pub struct RehearsedStep {
    /// Its procedure.
    pub procedure: &'static str,
    /// What it found.
    pub finding: Finding,
    /// What it wrote into the configuration.
    pub changes: Vec<(String, Value)>,
}

/// All steps of a car, and all questions.
#[derive(Clone, Debug)]
pub struct Rehearsal {
    /// The steps in their order.
    pub steps: Vec<RehearsedStep>,
    /// The questions, each once.
    pub questions: Vec<Question>,
    /// The configuration at the end.
    pub file: String,
}

/// Why a car did not come to the end.
#[derive(Debug, thiserror::Error)]
pub enum RehearsalError {
    /// There is no such car.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// A step failed.
    #[error("{step}: {found}")]
    Step {
        /// The step.
        step: String,
        /// What it found.
        found: String,
    },
    /// A value does not fit.
    #[error(transparent)]
    Edit(#[from] EditError),
}

impl Rehearsal {
    /// Takes the car through all procedures.
    ///
    /// # Errors
    ///
    /// A step fails.
    pub fn of(car: &OnboardCar) -> Result<Self, RehearsalError> {
        let mut bench = VirtualBench::new(car)?;
        let mut steps = Vec::new();
        for procedure in procedures() {
            for step in &procedure.steps {
                let before = bench.changes().len();
                let error = |found: String| RehearsalError::Step {
                    step: format!("{} {}", procedure.name, step.name),
                    found,
                };
                let findings = run(core::slice::from_ref(step), &mut bench, &mut NoJournal)
                    .map_err(|interrupted| error(interrupted.to_string()))?;
                for finding in findings {
                    if finding.verdict == Verdict::Failed {
                        return Err(error(finding.found));
                    }
                    steps.push(RehearsedStep {
                        procedure: procedure.name,
                        finding,
                        changes: bench.changes().get(before..).unwrap_or_default().to_vec(),
                    });
                }
            }
            bench.end_procedure();
        }
        Ok(Self {
            steps,
            questions: bench.questions().to_vec(),
            file: bench.file().to_owned(),
        })
    }

    /// Writes what these steps of a procedure wrote into a configuration.
    ///
    /// # Errors
    ///
    /// A value does not fit.
    pub fn apply(
        &self,
        procedure: &str,
        is_done: impl Fn(&str) -> bool,
        file: &mut Edit,
    ) -> Result<(), EditError> {
        let steps = self.steps.iter();
        for step in steps.filter(|step| step.procedure == procedure && is_done(&step.finding.step))
        {
            for (key, value) in &step.changes {
                file.set(key, value)?;
            }
        }
        Ok(())
    }

    /// The question whose text this is, but for its numbers.
    pub fn question(&self, text: &str) -> Option<&Question> {
        let without_numbers = |text: &str| text.replace(|c: char| c.is_ascii_digit(), "");
        let wanted = without_numbers(text);
        let mut questions = self.questions.iter();
        questions.find(|question| without_numbers(&question.text) == wanted)
    }
}
