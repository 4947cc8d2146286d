//! The whole pilot on the simulated car, board and cameras.

use std::path::Path;

use singletrack_control::{Position, Reference, Velocity};
use singletrack_core::{
    config::{Config, ConfigError, LawKind},
    online_calibration::OnlineCalibration,
};
use singletrack_pilot::{Arming, Mode, Output, PilotRequest, Reason};
use singletrack_record::Entry;
use singletrack_sim::{LossWindow, SimulationConfig, Truth};

use super::{
    Operator, OperatorSection, Simulation,
    scenario::{Scenario, ScenarioError, SteeringHold},
    summary::{CalibrationLine, ROWS_PER_SECOND, Row, Summary, Tally, drives},
};
use crate::{
    tracking::TrackingError,
    virtual_drive::{READY_TIMEOUT, VirtualDrive, VirtualDriveError, VirtualTick},
    virtual_record::{VirtualRecord, VirtualRecordError},
};

/// Why a scenario failed on the simulated car.
#[derive(Debug, thiserror::Error)]
pub enum CarError {
    /// The scenario can't be driven.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The drive did not start.
    #[error(transparent)]
    Drive(#[from] VirtualDriveError),
    /// The record could not be written.
    #[error(transparent)]
    Record(#[from] VirtualRecordError),
}

impl From<ConfigError> for CarError {
    fn from(error: ConfigError) -> Self {
        ScenarioError::from(error).into()
    }
}

/// The configurations of the daemon and of the simulation for a scenario.
///
/// # Errors
///
/// A scenario that only the ideal plant can run.
pub fn virtual_drive_config(scenario: &Scenario) -> Result<(Config, SimulationConfig), CarError> {
    if scenario.law.kind != LawKind::FrontPoint {
        return Err(ScenarioError::value(
            "law.kind",
            "velocity-point",
            "the pilot drives the car by the front-point law; use plant kind \"ideal\" for this one",
        )
        .into());
    }
    if scenario.control.period_ms == 0 {
        return Err(ScenarioError::value(
            "control.period_ms",
            0,
            "the pilot of plant kind \"car\" runs in ticks; set it to 10",
        )
        .into());
    }
    scenario.outer_loop.validate_for(&scenario.reference()?)?;
    let mut config = scenario.daemon()?;
    let simulation = scenario.simulation(&config)?;
    config.reference = config.reference.with_points_inlined()?;
    config.validate()?;
    Ok((config, simulation))
}

/// Drives a scenario on the simulated car, without marker losses and tunings, and passes on each entry
/// of its record. Returns the configuration of the drive.
///
/// # Errors
///
/// The car can't drive the scenario, or does not start.
pub fn drive_entries(
    scenario: &Scenario,
    take: &mut impl FnMut(&Entry),
) -> Result<Config, CarError> {
    let (daemon, simulation) = virtual_drive_config(scenario)?;
    let mut drive = VirtualDrive::new(daemon.clone(), scenario.run.seed, simulation)?;
    drive.keep_entries();
    let first = drive.start()?;
    let mut now = first.now;
    while now.seconds_since(first.now) < scenario.run.duration_s {
        now = drive.step().now;
        for entry in drive.entries() {
            take(&entry);
        }
    }
    Ok(daemon)
}

/// How a scenario is run on the car.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunOptions<'a> {
    /// Where to write a record of the drive.
    pub record: Option<&'a Path>,
    /// Whether the summary is wanted: a drive that does not start is a result then, and the
    /// run goes on after the end of a drive.
    pub summary: bool,
}

/// Simulated time after the end of a drive for the summary, in s: a car that rolls freely
/// stands by then.
const AFTER_END: f64 = 5.0;

/// Drives a scenario on the simulated car, with these configurations of daemon and simulator; time
/// zero is its first driving tick, or the start of the run if there is none.
///
/// # Errors
///
/// The car can't drive the scenario, or does not start.
pub fn simulate_configured(
    scenario: &Scenario,
    daemon: &Config,
    simulation: &SimulationConfig,
    options: RunOptions<'_>,
) -> Result<Simulation, CarError> {
    let period_us = daemon.control.period_ns() / 1_000;
    let under_way = simulation.cameras.latency_us.div_ceil(period_us);
    for loss in &scenario.marker_loss {
        if loss.first_tick <= under_way {
            return Err(ScenarioError::value(
                "marker_loss.first_tick",
                loss.first_tick,
                "on plant kind \"car\" the frames of the first ticks are under way when it starts; make it later",
            )
            .into());
        }
    }
    let takes_any_end = options.summary || scenario.expects_any_end();
    let operator = scenario.operator.unwrap_or_default();
    if operator.arm {
        let mut run = Run::new(scenario, daemon, simulation, options.record)?;
        match run.start() {
            Ok(()) => return run.finish(takes_any_end),
            Err(CarError::Drive(VirtualDriveError::NotStarted { .. })) if takes_any_end => {}
            Err(error) => return Err(error),
        }
        if let Some(path) = options.record {
            // The run is repeated from its start, with a record of its own.
            let _ = std::fs::remove_file(path);
        }
    }
    let mut run = Run::new(scenario, daemon, simulation, options.record)?;
    run.start_without_drive(operator.arm);
    run.finish(takes_any_end)
}

/// A run of a scenario.
struct Run<'a> {
    scenario: &'a Scenario,
    daemon: &'a Config,
    /// The true distance of the front axle from G, in m.
    front_axle_distance_m: f64,
    latency_us: u64,
    /// In a box: host and world are too large for a thread's stack.
    drive: Box<VirtualDrive>,
    record: Option<VirtualRecord>,
    unrecorded: Option<VirtualRecordError>,
    operator: Operator,
    /// Arms the car as soon as it is ready, until the time-out.
    arms: bool,
    /// Simulation time at which the host reaches the board, in µs.
    connected_us: u64,
    /// The least duration of the run, in s.
    least_s: f64,
    start_us: u64,
    tally: Tally,
    last: Option<VirtualTick>,
    /// As the pilot has begun it.
    reference: Reference,
    /// Of the reference.
    path: PathClock,
    calibration: Option<OnlineCalibration>,
}

impl<'a> Run<'a> {
    fn new(
        scenario: &'a Scenario,
        daemon: &'a Config,
        simulation: &SimulationConfig,
        record: Option<&Path>,
    ) -> Result<Self, CarError> {
        let seed = scenario.run.seed;
        let drive = VirtualDrive::new(daemon.clone(), seed, simulation.clone())?;
        let mut drive = Box::new(drive);
        // Until the car drives, nothing timed happens to it.
        drive.world_mut().set_epoch(None);
        let connected_us = match scenario.expects_any_end() {
            true => (scenario.operator.unwrap_or_default().daemon_after_s * 1e6) as u64,
            // A car whose ESC is ready when it must be, as configured.
            false => 0,
        };
        drive.world_mut().set_wire_connected(connected_us == 0);
        let record = record
            .map(|path| VirtualRecord::start(path, &mut drive, daemon, seed))
            .transpose()?;
        let fence = daemon.fence.fence(&daemon.vehicle)?;
        let tally = Tally::new(&fence).map_err(ConfigError::Fence)?;
        Ok(Self {
            scenario,
            daemon,
            front_axle_distance_m: simulation.car.vehicle.front_axle_distance_m,
            latency_us: simulation.cameras.latency_us,
            drive,
            record,
            unrecorded: None,
            operator: Operator::new(&scenario.operator.unwrap_or_default(), &scenario.tune),
            arms: false,
            connected_us,
            least_s: 0.0,
            start_us: 0,
            tally,
            last: None,
            reference: scenario.reference()?,
            path: PathClock::default(),
            calibration: OnlineCalibration::new(daemon),
        })
    }

    /// Goes on to the first driving tick.
    fn start(&mut self) -> Result<(), CarError> {
        while self.drive.next_tick_us() < self.connected_us {
            self.drive.step();
        }
        self.drive.world_mut().set_wire_connected(true);
        let first = self.drive.start()?;
        self.connected_us = 0;
        self.start_us = first.now.0 / 1_000;
        self.drive.world_mut().set_epoch(Some(self.start_us));
        self.take(first);
        self.lose_markers();
        Ok(())
    }

    /// Starts at the start of the simulation. The car is never armed, or refuses it: then
    /// there is no time from which anything could count.
    fn start_without_drive(&mut self, arms: bool) {
        if arms {
            self.arms = true;
            self.least_s = READY_TIMEOUT;
            self.operator = Operator::new(&OperatorSection::default(), &[]);
        } else {
            self.drive.world_mut().set_epoch(Some(0));
            self.lose_markers();
        }
    }

    fn lose_markers(&mut self) {
        let period_us = self.daemon.control.period_ns() / 1_000;
        for loss in &self.scenario.marker_loss {
            // A tick is lost when no frame arrives in the period before it.
            let first_us = self.start_us + (loss.first_tick - 1) * period_us - self.latency_us;
            self.drive
                .world_mut()
                .cameras_mut()
                .add_loss_window(LossWindow {
                    start_us: first_us,
                    end_us: first_us + loss.ticks * period_us,
                });
        }
    }

    /// Time of the run, in s.
    fn time(&self, now_us: u64) -> f64 {
        now_us.saturating_sub(self.start_us) as f64 * 1e-6
    }

    fn take(&mut self, tick: VirtualTick) {
        let time = self.time(tick.now.0 / 1_000);
        self.tally.add(time, &tick);
        let output = &tick.tick.output;
        if let (Some(0.0), Some(point), Some(estimate)) =
            (output.drive_time, output.point, output.estimate)
        {
            let start = self.daemon.reference.start();
            self.reference.begin(start, &point, estimate.yaw);
        }
        self.path.take(time, output);
        let calibration = self.calibration.as_mut();
        if let Some(learned) = calibration.and_then(|it| it.tick(&tick.tick)) {
            // Nothing else fills the ring.
            let _ = self.drive.learned(learned);
        }
        self.last = Some(tick);
    }

    fn step(&mut self) -> Result<(), CarError> {
        let next_us = self.drive.next_tick_us();
        if self.connected_us > 0 && next_us >= self.connected_us {
            self.connected_us = 0;
            let connected = !self.operator.has_unplugged();
            self.drive.world_mut().set_wire_connected(connected);
        }
        let time = self.time(next_us);
        self.operator.act(&mut self.drive, time)?;
        if self.arms && time >= READY_TIMEOUT {
            self.arms = false;
        }
        if self.arms && self.drive.mode() == Mode::Ready {
            self.arms = self
                .drive
                .request(PilotRequest::Arm(Arming::Unattended))
                .is_err();
        }
        let tick = self.drive.step();
        self.take(tick);
        Ok(())
    }

    /// Goes on to the end of the run.
    fn finish(mut self, takes_any_end: bool) -> Result<Simulation, CarError> {
        let duration_s = self.scenario.run.duration_s;
        let count = (duration_s * ROWS_PER_SECOND as f64 + 1e-6) as u64;
        let mut ended = None;
        let mut distances = Vec::new();
        let mut rows = Vec::new();
        for index in 0..=count {
            let row_us = self.start_us + index * 1_000_000 / ROWS_PER_SECOND;
            // Ticks until then, and at that time.
            while !self.drive.advance_to(row_us) {
                self.step()?;
            }
            self.write();
            let time = index as f64 / ROWS_PER_SECOND as f64;
            let Some(last) = &self.last else {
                // Before the first tick.
                continue;
            };
            let truth = if row_us == last.now.0 / 1_000 {
                last.truth
            } else {
                self.drive.world().truth()
            };
            let output = &last.tick.output;
            if !drives(output.mode) && ended.is_none() {
                let reason = output.reason.map_or("no reason", Reason::name);
                ended = Some(format!(
                    "the car no longer follows its reference from t = {time} s on: {}, {reason}",
                    output.mode
                ));
            }
            let row = self.row(time, &truth, last);
            if drives(output.mode) {
                distances.push(row.distance_from_reference());
            }
            rows.push(row);
        }
        if takes_any_end {
            let until_s = |run: &Self| {
                let after = run
                    .tally
                    .ended_s()
                    .map_or(0.0, |ended_s| ended_s + AFTER_END);
                duration_s.max(after).max(run.least_s)
            };
            while self.time(self.drive.next_tick_us()) <= until_s(&self) {
                self.step()?;
                self.write();
            }
        }
        if let Some(error) = self.unrecorded {
            return Err(error.into());
        }
        if let Some(record) = self.record {
            record.finish(&mut self.drive)?;
        }
        let mut notes = Vec::new();
        let control = &self.scenario.control;
        if control.delay_ticks > 0 || control.steering == SteeringHold::Step {
            notes.push(
                "control.delay_ticks and control.steering are the ideal plant's; the car has its own \
                 delays, and a servo"
                    .to_owned(),
            );
        }
        notes.extend(ended);
        let tracking_error = TrackingError::of(&distances);
        let later = TrackingError::of(&distances[distances.len() / 2..]);
        let estimates = self.calibration.as_ref().map(OnlineCalibration::estimates);
        let summary = Summary {
            tracking_rms_m: later.map(|error| error.rms_m),
            calibration: estimates
                .into_iter()
                .flatten()
                .map(|estimate| CalibrationLine::from(&estimate))
                .collect(),
            ..self.tally.summary(tracking_error)
        };
        Ok(Simulation {
            rows,
            notes,
            tracking_error,
            summary: Some(summary),
            estimates: estimates.map_or_else(Vec::new, Vec::from),
        })
    }

    fn write(&mut self) {
        if let Some(record) = &mut self.record
            && self.unrecorded.is_none()
        {
            self.unrecorded = record.write(&mut self.drive).err();
        }
    }

    fn row(&self, time: f64, truth: &Truth, last: &VirtualTick) -> Row {
        let output = &last.tick.output;
        // P is where it was tuned to be.
        let configured = self.scenario.law.point_distance_m;
        let point_distance = output
            .tuned
            .map_or(configured, |tuned| tuned.point_distance);
        let [x_p, y_p] = truth.point_p(self.front_axle_distance_m, point_distance);
        let start = Position::from(self.scenario.start.point_p_m);
        let path = self.path.at(time);
        let nominal = match &self.reference {
            Reference::VelocitySteps(steps) => steps.integrate(start, time),
            other => other.at(path).position.unwrap_or(start) + self.path.beside(other),
        };
        let wanted = output.point_velocity.unwrap_or_default();
        let rate = match output.mode {
            Mode::Driving | Mode::Slowing => output.actuation.steering_rate,
            _ => 0.0,
        };
        Row {
            t: time,
            yaw: truth.yaw,
            yaw_rate: truth.yaw_rate,
            sideslip: truth.sideslip,
            steering: truth.steering,
            x_g: truth.x,
            y_g: truth.y,
            speed: output.actuation.speed,
            steering_rate: rate,
            x_p,
            y_p,
            x_ref: nominal.x,
            y_ref: nominal.y,
            v_px: wanted.x,
            v_py: wanted.y,
            path_s: path,
        }
    }
}

/// The path parameter of the reference between the ticks.
#[derive(Clone, Copy, Debug, Default)]
struct PathClock {
    /// Time and path parameter at the last tick that followed the reference, s.
    last: (f64, f64),
    /// Its advance per second after that.
    rate: f64,
    is_slowed: bool,
    /// The governed reference there, m.
    governed: Option<Position>,
}

impl PathClock {
    fn take(&mut self, time: f64, output: &Output) {
        let (Some(path), Some(driven)) = (output.path, output.drive_time) else {
            return;
        };
        let (then, before) = self.last;
        if time > then {
            self.rate = ((path - before) / (time - then)).clamp(0.0, 1.0);
        }
        self.last = (time, path);
        self.is_slowed = path != driven;
        self.governed = output.reference.and_then(|point| point.position);
    }

    /// How far the governed reference is beside its path, in m.
    fn beside(&self, reference: &Reference) -> Velocity {
        let place = reference.at(self.last.1).position;
        match (self.governed, place) {
            (Some(governed), Some(place)) if self.is_slowed => governed - place,
            _ => Velocity::zeros(),
        }
    }

    /// The path parameter at a time of the run.
    fn at(&self, time: f64) -> f64 {
        if self.is_slowed {
            self.last.1 + self.rate * (time - self.last.0)
        } else {
            time
        }
    }
}
