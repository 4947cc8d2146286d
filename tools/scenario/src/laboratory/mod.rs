//! A laboratory: host, board, cameras and car in virtual time, and what one does with them by hand.
//! Python, the browser and the scenarios wrap it.

mod fault;
mod setup;

use std::path::Path;

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
use singletrack_sim::{LossPattern, LossWindow, SimulationConfig, StartPose, parse_duration_us};

use crate::{
    virtual_drive::{VirtualDrive, VirtualDriveError, VirtualTick},
    virtual_record::{VirtualRecord, VirtualRecordError},
};

pub use fault::FaultValue;
pub use setup::{Setup, SetupError, TruthRange, choice, reference};

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
        fault::set(&mut self.drive.world, name, value)
    }

    /// Puts the car down elsewhere, at rest.
    ///
    /// # Errors
    ///
    /// A number is not finite, or too large for a floor.
    pub fn place(&mut self, pose: StartPose) -> Result<(), SetupError> {
        setup::check_place("this", &pose)?;
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
