//! A laboratory: host, board, cameras and car in virtual time, set up from a few keys, and what one does
//! with them by hand, such as a fault by its name. Python, the browser and the scenarios wrap it.

use std::path::Path;

use serde::{Deserialize, de::DeserializeOwned};
use singletrack_api::{Code, Refused, Setpoint, State};
use singletrack_control::Time;
use singletrack_core::{
    Stalled,
    config::{Config, ReferenceSection},
    reconfigure::ChangeError,
    setpoint::SetpointCommand,
    state_stream::States,
};
use singletrack_pilot::{Arming, PilotRequest};
use singletrack_record::Digest;
use singletrack_sim::{
    CarTruth, ImuFault, LossKind, LossPattern, LossWindow, MotorSensorFault, SimulationConfig,
    StartPose, parse_duration_us,
};
use toml::{Table, Value};

use crate::{
    simulated::{Drive, daemon_config, follow, merge, start_of},
    virtual_drive::{VirtualDrive, VirtualDriveError, VirtualTick},
    virtual_record::{VirtualRecord, VirtualRecordError},
};

/// Why a simulation can't be set up; the text names the key.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SetupError(String);

impl SetupError {
    /// With the text of another error.
    #[expect(clippy::needless_pass_by_value, reason = "for map_err")]
    pub fn new(text: impl ToString) -> Self {
        Self(text.to_string().trim_end().to_owned())
    }
}

/// A named number of the table `[truth]`, such as `servo.lag_ms`.
#[derive(Clone, Debug)]
pub struct TruthRange {
    /// Name of the section, such as `servo`.
    pub section: String,
    /// Name of the key, such as `lag_ms`.
    pub key: String,
    /// The smallest value, in the key's unit.
    pub low: f64,
    /// The largest value, in the key's unit.
    pub high: f64,
}

/// What is believed and what is true of a simulated car.
#[derive(Clone, Debug)]
pub struct Setup {
    /// The daemon's configuration: what is believed.
    pub config: Config,
    /// The car as it is believed to be; [`Setup::simulation`] adds the truth.
    pub simulation: SimulationConfig,
    truth: Table,
}

impl Setup {
    /// `configuration` holds keys of the daemon's configuration that differ from those of
    /// the simulated car, `truth` what is true of the car and differs from the configuration.
    ///
    /// # Errors
    ///
    /// One of the texts is not TOML, or the configuration is refused.
    pub fn new(
        reference: ReferenceSection,
        configuration: &str,
        truth: &str,
    ) -> Result<Self, SetupError> {
        let mut config = daemon_config(Drive::following(reference));
        let written: Table = parse("configuration", configuration)?;
        if !written.is_empty() {
            let own = config.to_toml().map_err(SetupError::new)?;
            let mut table: Table = parse("configuration", &own)?;
            // The keys of a reference depend on its kind.
            if written.contains_key("reference") {
                table.insert("reference".to_owned(), Value::Table(Table::new()));
            }
            merge(&mut table, &written);
            let text = toml::to_string(&table).map_err(SetupError::new)?;
            config = Config::from_toml(&text).map_err(SetupError::new)?;
        }
        let mut simulation = SimulationConfig::default();
        simulation.car.vehicle = config.vehicle;
        follow(&config, &mut simulation);
        Ok(Self {
            config,
            simulation,
            truth: parse("truth", truth)?,
        })
    }

    /// The simulation of one car of this kind, with values drawn for keys of `[truth]`.
    ///
    /// # Errors
    ///
    /// The start is not finite or too far away, or a key of the truth is refused.
    pub fn simulation(
        &self,
        seed: u64,
        start: StartPose,
        drawn: &[(&TruthRange, f64)],
    ) -> Result<SimulationConfig, SetupError> {
        check_place("the start", &start)?;
        let mut simulation = self.simulation.clone();
        simulation.seed = seed;
        simulation.car.start = start;
        let mut truth = self.truth.clone();
        for (range, value) in drawn {
            let section = truth
                .entry(range.section.clone())
                .or_insert_with(|| Value::Table(Table::new()));
            if let Value::Table(section) = section {
                section.insert(range.key.clone(), Value::Float(*value));
            }
        }
        if !truth.is_empty() {
            let truth: CarTruth = truth.try_into().map_err(SetupError::new)?;
            truth.apply(&mut simulation).map_err(SetupError::new)?;
        }
        Ok(simulation)
    }

    /// Where G must be for P to stand at `point` (m), with straight wheels.
    pub fn start(&self, point: [f64; 2], yaw_rad: f64) -> StartPose {
        let law = &self.config.law;
        let ahead = law.front_axle_distance_m + law.point_distance_m;
        start_of(point, ahead, yaw_rad)
    }
}

/// The value of a fault: a word, a number, numbers, or whether it is so.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(
    untagged,
    expecting = "use a word, a number, a list of numbers, true or false"
)]
pub enum FaultValue {
    /// State of a switch.
    Switch(bool),
    /// An amount, in the unit that the fault's name ends with.
    Number(f64),
    /// A displacement.
    Numbers(Vec<f64>),
    /// The word for a kind.
    Word(String),
}

/// Ticks after which the kept entries are written to the record.
const TICKS_PER_WRITE: u32 = 100;

/// A host, a board, cameras and a car in virtual time.
pub struct Laboratory {
    /// The configuration in force.
    pub config: Config,
    seed: u64,
    // Host and world are too large for a thread's stack.
    /// The host and the world.
    pub drive: Box<VirtualDrive>,
    last: Option<VirtualTick>,
    states: States,
    /// The digest of the ticks since [`Laboratory::keep_digest`].
    pub digest: Option<Digest>,
    record: Option<VirtualRecord>,
    unwritten: u32,
}

impl Laboratory {
    /// Powers everything on. `seed` is that of the host's session with the board.
    ///
    /// # Errors
    ///
    /// One of the parts refuses its configuration.
    pub fn new(
        config: Config,
        seed: u64,
        simulation: SimulationConfig,
    ) -> Result<Self, VirtualDriveError> {
        Ok(Self {
            drive: Box::new(VirtualDrive::new(config.clone(), seed, simulation)?),
            config,
            seed,
            last: None,
            states: States::default(),
            digest: None,
            record: None,
            unwritten: 0,
        })
    }

    /// Records the drive to a file, or in memory without one, from now on: see
    /// [`Laboratory::take_record`]. A replay needs it from the first tick on.
    ///
    /// # Errors
    ///
    /// The file exists or can't be written.
    pub fn record(&mut self, path: Option<&Path>) -> Result<(), VirtualRecordError> {
        let record = VirtualRecord::start(path, &mut self.drive, &self.config, self.seed)?;
        self.record = Some(record);
        Ok(())
    }

    /// Completes the record in memory, and returns it; empty if there is none.
    ///
    /// # Errors
    ///
    /// The record can't be completed.
    pub fn take_record(&mut self) -> Result<Vec<u8>, VirtualRecordError> {
        match self.record.take() {
            Some(record) => record.into_bytes(&mut self.drive),
            None => Ok(Vec::new()),
        }
    }

    /// Computes the digest of the drive, from now on.
    pub fn keep_digest(&mut self) {
        self.digest = Some(Digest::default());
    }

    /// Waits until the car can drive, arms it, and goes on to the first driving tick, which it
    /// returns. An external reference gets standstill as its set-point.
    ///
    /// # Errors
    ///
    /// The car does not drive within 15 s.
    pub fn start(&mut self) -> Result<&VirtualTick, VirtualDriveError> {
        let (states, digest) = (&mut self.states, &mut self.digest);
        let first = self
            .drive
            .start_with(&mut |tick| take(states, digest, tick));
        Ok(self.last.insert(first?))
    }

    /// Runs a tick.
    ///
    /// # Errors
    ///
    /// The record can't be written.
    pub fn step(&mut self) -> Result<&VirtualTick, VirtualRecordError> {
        let tick = self.drive.step();
        take(&mut self.states, &mut self.digest, &tick);
        self.unwritten += 1;
        if let Some(record) = &mut self.record
            && self.unwritten >= TICKS_PER_WRITE
        {
            record.write(&mut self.drive)?;
            self.unwritten = 0;
        }
        Ok(self.last.insert(tick))
    }

    /// The last tick; `None` before the first.
    pub const fn last(&self) -> Option<&VirtualTick> {
        self.last.as_ref()
    }

    /// What the last tick saw and did; `None` before the first.
    pub fn state(&self) -> Option<State> {
        Some(self.states.state(&self.last.as_ref()?.tick))
    }

    /// Time of the last tick; zero before the first.
    pub fn now(&self) -> Time {
        self.last.as_ref().map_or(Time(0), |last| last.now)
    }

    /// Sends the pilot a request by its word, for the next tick: `arm`, `disarm`, `stop`, `halt` or
    /// `carried`.
    ///
    /// # Errors
    ///
    /// The word is unknown, or the control loop has not taken earlier requests.
    pub fn request(&self, word: &str) -> Result<Result<(), Stalled>, SetupError> {
        let request = match word {
            "arm" => PilotRequest::Arm(Arming::Unattended),
            "disarm" => PilotRequest::Disarm,
            "stop" => PilotRequest::EmergencyStop,
            "halt" => PilotRequest::Halt,
            "carried" => PilotRequest::Carried,
            other => return Err(SetupError::new(format!("unknown request {other:?}"))),
        };
        Ok(self.drive.request(request))
    }

    /// Puts another reference in force; returns the number of the configuration.
    ///
    /// # Errors
    ///
    /// The pilot drives, or refuses the reference.
    pub fn set_reference(&mut self, reference: ReferenceSection) -> Result<u32, ChangeError> {
        let mut config = self.config.clone();
        config.reference = reference;
        let number = self.drive.reconfigure(config.clone())?;
        self.config = config;
        Ok(number)
    }

    /// Whether the reference is that of a controller outside.
    pub const fn is_external(&self) -> bool {
        matches!(self.config.reference, ReferenceSection::External { .. })
    }

    /// Gives a set-point by the keys of the control socket, decided after the last tick.
    ///
    /// # Errors
    ///
    /// There was no tick, or the daemon would not obey it.
    pub fn setpoint(&self, keys: Setpoint) -> Result<(), Refused> {
        let refusal = || Refused::new(Code::NotReady, "run a tick before the first set-point");
        let last = self.last.as_ref().ok_or_else(refusal)?;
        let command = SetpointCommand::of(keys, last.now)?;
        self.drive.host().parts.setpoints.pass(&command);
        Ok(())
    }

    /// Where P truly is now, in m, with the believed distances of the front axle and of P.
    pub fn true_point(&self) -> [f64; 2] {
        let law = &self.config.law;
        let truth = self.drive.world.truth();
        truth.point_p(law.front_axle_distance_m, law.point_distance_m)
    }

    /// Loses the markers periodically, such as `200ms@2s` from now on; never with `None`.
    ///
    /// # Errors
    ///
    /// The text is no such pattern.
    pub fn marker_loss(&mut self, pattern: Option<&str>) -> Result<(), SetupError> {
        let pattern = pattern.map(str::parse::<LossPattern>).transpose();
        let pattern = pattern.map_err(SetupError::new)?;
        let world = &mut self.drive.world;
        let now_us = world.now_us;
        world.cameras.loss_epoch_us = Some(now_us);
        world.cameras.parameters.loss = pattern;
        Ok(())
    }

    /// Loses the markers once, from now on, for a duration such as `300ms`.
    ///
    /// # Errors
    ///
    /// The text is no duration.
    pub fn lose_markers(&mut self, duration: &str) -> Result<(), SetupError> {
        let duration_us = parse_duration_us(duration).map_err(SetupError::new)?;
        let world = &mut self.drive.world;
        let now_us = world.now_us;
        world.cameras.loss_epoch_us = Some(0);
        world.cameras.parameters.loss_windows.push(LossWindow {
            start_us: now_us,
            end_us: now_us + duration_us,
        });
        Ok(())
    }

    /// Sets a fault by its name.
    ///
    /// # Errors
    ///
    /// The name or the value is unknown; the text lists those that are known.
    pub fn set_fault(&mut self, name: &str, value: &FaultValue) -> Result<(), SetupError> {
        use FaultValue::{Number, Numbers, Switch, Word};

        let world = &mut self.drive.world;
        let cameras = &mut world.cameras.faults;
        let line = &mut world.wire.faults;
        match (name, value) {
            ("imu", Word(word)) => {
                let known = [
                    ("none", ImuFault::None),
                    ("silent", ImuFault::Silent),
                    ("stuck", ImuFault::Stuck),
                    ("saturated", ImuFault::Saturated),
                    ("erratic", ImuFault::Erratic),
                ];
                world.imu_fault = choice(name, word, &known)?;
            }
            ("motor_sensor", Word(word)) => {
                let known = MotorSensorFault::ALL.map(|fault| (fault.name(), fault));
                world.car.sensor_fault = choice(name, word, &known)?;
            }
            ("cameras", Word(word)) => {
                let kinds = LossKind::ALL.map(|kind| (kind.name(), Some(kind)));
                let known = [&[("none", None)], &kinds[..]].concat();
                cameras.loss = choice(name, word, &known)?;
            }
            ("camera_jump_m", Numbers(jump)) if jump.iter().all(|it| in_hall(*it)) => {
                let jump = <[f64; 3]>::try_from(&jump[..]);
                cameras.jump_m = jump.map_err(|_| refusal(name, value))?;
            }
            ("line_drop", Number(share @ 0.0..=1.0)) => line.drop = *share,
            ("line_corrupt", Number(share @ 0.0..=1.0)) => line.corrupt = *share,
            ("line_delay_us", Number(us @ 0.0..)) if us.trunc() == *us => {
                line.delay_us = *us as u64;
            }
            ("line_stuck", Switch(on)) => line.stuck = *on,
            ("cable", Switch(on)) => world.set_cable(*on),
            ("board_power", Switch(on)) => world.set_board_power(*on),
            ("esc_power", Switch(on)) => world.car.set_esc_power(*on),
            ("battery", Switch(on)) => world.car.set_battery_plugged(*on),
            ("servo_reversed", Switch(on)) => world.car.set_servo_reversed(*on),
            ("stop_switch", Switch(on)) => world.board.stop_input_open = *on,
            _ => return Err(refusal(name, value)),
        }
        Ok(())
    }

    /// Puts the car down elsewhere, at rest.
    ///
    /// # Errors
    ///
    /// A number is not finite, or too large for a floor.
    pub fn place(&mut self, pose: StartPose) -> Result<(), SetupError> {
        check_place("this", &pose)?;
        self.drive.world.car.place(pose);
        Ok(())
    }

    /// Completes the record, if there is one.
    ///
    /// # Errors
    ///
    /// The file can't be written.
    pub fn finish(&mut self) -> Result<(), VirtualRecordError> {
        if let Some(record) = self.record.take() {
            record.finish(&mut self.drive)?;
        }
        Ok(())
    }
}

fn take(states: &mut States, digest: &mut Option<Digest>, tick: &VirtualTick) {
    states.tick(&tick.tick);
    if let Some(digest) = digest {
        digest.add(&tick.tick);
    }
}

/// Why a fault can't be set to a value.
fn refusal(name: &str, value: &FaultValue) -> SetupError {
    let wanted = match name {
        "imu" | "motor_sensor" | "cameras" => "give a word",
        "camera_jump_m" => "give three lengths in m",
        "line_drop" | "line_corrupt" => "it must be between 0 and 1",
        "line_delay_us" => "give a whole number of µs",
        "line_stuck" | "cable" | "board_power" | "esc_power" | "battery" | "servo_reversed"
        | "stop_switch" => "give true or false",
        _ => {
            return SetupError::new(format!(
                "unknown fault {name:?}: use imu, motor_sensor, cameras, camera_jump_m, \
                 line_drop, line_corrupt, line_delay_us, line_stuck, cable, board_power, \
                 esc_power, battery, servo_reversed or stop_switch"
            ));
        }
    };
    let given = match value {
        FaultValue::Switch(on) => on.to_string(),
        FaultValue::Number(number) => number.to_string(),
        FaultValue::Numbers(numbers) => format!("{numbers:?}"),
        FaultValue::Word(word) => format!("{word:?}"),
    };
    SetupError::new(format!("{name} is {given}: {wanted}"))
}

/// Whether a coordinate in m, or an angle in rad, is that of a car.
fn in_hall(value: f64) -> bool {
    value.abs() <= 1e4
}

/// Refuses a place that no car has.
fn check_place(what: &str, place: &StartPose) -> Result<(), SetupError> {
    match [place.x_m, place.y_m, place.yaw_rad]
        .into_iter()
        .all(in_hall)
    {
        true => Ok(()),
        false => Err(SetupError::new(format!("{what} is not a place on a floor"))),
    }
}

/// The section of a reference, from its TOML text.
///
/// # Errors
///
/// The text is no reference.
pub fn reference(text: &str) -> Result<ReferenceSection, SetupError> {
    parse("reference", text)
}

fn parse<T: DeserializeOwned>(what: &str, text: &str) -> Result<T, SetupError> {
    toml::from_str(text).map_err(|error| SetupError::new(format!("{what}: {error}")))
}

/// The value of a word.
///
/// # Errors
///
/// The word is not known; the text lists those that are.
pub fn choice<T: Copy>(name: &str, word: &str, known: &[(&str, T)]) -> Result<T, SetupError> {
    let found = known.iter().find(|(known, _)| *known == word);
    found.map(|(_, value)| *value).ok_or_else(|| {
        let words: Vec<String> = known.iter().map(|(word, _)| format!("{word:?}")).collect();
        SetupError::new(format!("{name} is {word:?}: use {}", words.join(" or ")))
    })
}
