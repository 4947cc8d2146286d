//! The whole pilot on the simulated car, board and cameras.

use std::path::Path;

use singletrack_control::{Position, Reference, Velocity};
use singletrack_core::{
    config::{Config, ConfigError, LawKind},
    online_calibration::OnlineCalibration,
};
use singletrack_pilot::{Arming, Mode, Output, PilotRequest, Reason};
use singletrack_sim::{LossWindow, SimulationConfig, Truth, World};

use super::{
    Operator, OperatorSection, SimulateError, Simulation,
    scenario::{MarkerLoss, Scenario, SteeringHold, require},
    summary::{CalibrationLine, ROWS_PER_SECOND, Row, Summary, Tally, drives, row_time},
};
use crate::{
    laboratory::Laboratory,
    tracking::TrackingError,
    virtual_drive::{READY_TIMEOUT, VirtualDriveError, VirtualTick},
};

/// The configurations of the daemon and of the simulation for a scenario.
///
/// # Errors
///
/// A scenario that only the ideal plant can run.
pub fn virtual_drive_config(
    scenario: &Scenario,
) -> Result<(Config, SimulationConfig), SimulateError> {
    let is_front_point = scenario.law.kind == LawKind::FrontPoint;
    let fix =
        "the pilot drives the car by the front-point law; use plant kind \"ideal\" for this one";
    require(is_front_point, "law.kind", "velocity-point", fix)?;
    let (period_ms, key) = (scenario.control.period_ms, "control.period_ms");
    let fix = "the pilot of plant kind \"car\" runs in ticks; set it to 10";
    require(period_ms > 0, key, period_ms, fix)?;
    scenario.outer_loop.validate_for(&scenario.reference()?)?;
    let mut config = scenario.daemon()?;
    let simulation = scenario.simulation(&config)?;
    config.reference = config.reference.with_points_inlined()?;
    config.validate()?;
    Ok((config, simulation))
}

/// How a scenario is run on the car.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunOptions<'a> {
    /// Where to write a record of the drive.
    pub record: Option<&'a Path>,
    /// Whether to record the drive in memory: see [`Laboratory::take_record`].
    pub in_memory: bool,
    /// Whether the digest of the drive is wanted.
    pub digest: bool,
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
) -> Result<Simulation, SimulateError> {
    let mut run = ScenarioRun::begin(scenario, daemon, simulation, options)?;
    let mut rows = Vec::new();
    while !run.is_complete() {
        if let Progress::Row(row) = run.advance()? {
            rows.push(row);
        }
    }
    run.finish(rows)
}

/// What a run went on to.
#[derive(Clone, Copy, Debug)]
pub enum Progress {
    /// A tick.
    Tick,
    /// The time of a row. Before the first tick there are none.
    Row(Row),
}

/// A run of a scenario, tick by tick.
pub struct ScenarioRun {
    scenario: Scenario,
    /// Host, board, cameras and car.
    pub laboratory: Laboratory,
    takes_any_end: bool,
    /// The true distance of the front axle from G, in m.
    front_axle_distance_m: f64,
    latency_us: u64,
    operator: Operator,
    /// Arms the car as soon as it is ready, until the time-out.
    arms: bool,
    /// Simulation time at which the host reaches the board, in µs.
    connected_us: u64,
    /// The least duration of the run, in s.
    least_s: f64,
    start_us: u64,
    tally: Tally,
    /// The reference that the pilot has begun.
    reference: Reference,
    /// Clock of the reference.
    path: PathClock,
    calibration: Option<OnlineCalibration>,
    /// Number of the next row.
    next_row: u64,
    /// When the car ceased to follow its reference, in words.
    ended: Option<String>,
    /// Distances of P from the reference, in the rows of the drive, in m.
    distances: Vec<f64>,
}

impl ScenarioRun {
    /// Powers everything on and goes on to the first driving tick, which is time zero; or to the
    /// start of the run, if there is no drive.
    ///
    /// # Errors
    ///
    /// The car can't drive the scenario, or does not start.
    pub fn begin(
        scenario: &Scenario,
        daemon: &Config,
        simulation: &SimulationConfig,
        options: RunOptions<'_>,
    ) -> Result<Self, SimulateError> {
        let period_us = daemon.control.period_ns() / 1_000;
        let under_way = simulation.cameras.latency_us.div_ceil(period_us);
        let key = "marker_loss.first_tick";
        let fix = "on plant kind \"car\" the frames of the first ticks are under way when it starts; make it later";
        for MarkerLoss { first_tick, .. } in &scenario.marker_loss {
            require(*first_tick > under_way, key, first_tick, fix)?;
        }
        let arms = scenario.operator.unwrap_or_default().arm;
        let mut run = Self::new(scenario, daemon, simulation, options)?;
        if arms {
            match run.start() {
                Ok(()) => return Ok(run),
                Err(SimulateError::Drive(VirtualDriveError::NotStarted { .. }))
                    if run.takes_any_end => {}
                Err(error) => return Err(error),
            }
            if let Some(path) = options.record {
                // The run is repeated from its start, with a record of its own.
                drop(run);
                let _ = std::fs::remove_file(path);
            }
            run = Self::new(scenario, daemon, simulation, options)?;
        }
        run.start_without_drive(arms);
        Ok(run)
    }

    fn new(
        scenario: &Scenario,
        daemon: &Config,
        simulation: &SimulationConfig,
        options: RunOptions<'_>,
    ) -> Result<Self, SimulateError> {
        let mut laboratory =
            Laboratory::new(daemon.clone(), scenario.run.seed, simulation.clone())?;
        if options.digest {
            laboratory.keep_digest();
        }
        if options.record.is_some() || options.in_memory {
            laboratory.record(options.record)?;
        }
        // Until the car drives, nothing timed happens to it.
        let world = &mut laboratory.drive.world;
        world.set_epoch(None);
        let connected_us = match scenario.expects_any_end() {
            true => (scenario.operator.unwrap_or_default().daemon_after_s * 1e6) as u64,
            // A car whose ESC is ready when it must be, as configured.
            false => 0,
        };
        world.set_wire_connected(connected_us == 0);
        let fence = daemon.fence.fence(&daemon.vehicle)?;
        let tally = Tally::new(&fence).map_err(ConfigError::Fence)?;
        Ok(Self {
            laboratory,
            takes_any_end: options.summary || scenario.expects_any_end(),
            front_axle_distance_m: simulation.car.vehicle.front_axle_distance_m,
            latency_us: simulation.cameras.latency_us,
            operator: Operator::new(&scenario.operator.unwrap_or_default(), &scenario.tune),
            arms: false,
            connected_us,
            least_s: 0.0,
            start_us: 0,
            tally,
            reference: scenario.reference()?,
            path: PathClock::default(),
            calibration: OnlineCalibration::new(daemon),
            next_row: 0,
            ended: None,
            distances: Vec::new(),
            scenario: scenario.clone(),
        })
    }

    /// Goes on to the first driving tick.
    fn start(&mut self) -> Result<(), SimulateError> {
        while self.laboratory.drive.next_tick_us() < self.connected_us {
            self.laboratory.step()?;
        }
        self.world().set_wire_connected(true);
        let first = self.laboratory.start()?.clone();
        self.connected_us = 0;
        self.start_us = first.now.0 / 1_000;
        let start_us = self.start_us;
        self.world().set_epoch(Some(start_us));
        self.take(&first);
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
            self.world().set_epoch(Some(0));
            self.lose_markers();
        }
    }

    const fn world(&mut self) -> &mut World {
        &mut self.laboratory.drive.world
    }

    fn lose_markers(&mut self) {
        let period_us = self.laboratory.config.control.period_ns() / 1_000;
        let last_tick = (self.scenario.run.duration_s * 1e6) as u64 / period_us;
        let windows = &mut self.laboratory.drive.world.cameras.parameters.loss_windows;
        for loss in &self.scenario.marker_loss {
            for first_tick in loss.beginnings(last_tick) {
                // A tick is lost when no frame arrives in the period before it.
                let start_us = self.start_us + (first_tick - 1) * period_us - self.latency_us;
                let end_us = start_us + loss.ticks * period_us;
                windows.push(LossWindow { start_us, end_us });
            }
        }
    }

    /// Time of the run, in s.
    fn time(&self, now_us: u64) -> f64 {
        now_us.saturating_sub(self.start_us) as f64 * 1e-6
    }

    fn take(&mut self, tick: &VirtualTick) {
        let time = self.time(tick.now.0 / 1_000);
        self.tally.add(time, tick);
        let output = &tick.tick.output;
        if let (Some(0.0), Some(point), Some(estimate)) =
            (output.drive_time, output.point, output.estimate)
        {
            let start = self.laboratory.config.reference.start();
            self.reference.begin(start, &point, estimate.yaw);
        }
        self.path.take(time, output);
        let calibration = self.calibration.as_mut();
        if let Some(learned) = calibration.and_then(|it| it.tick(&tick.tick)) {
            // Nothing else fills the ring.
            let _ = self.laboratory.drive.learned(learned);
        }
    }

    fn step(&mut self) -> Result<(), SimulateError> {
        let next_us = self.laboratory.drive.next_tick_us();
        if self.connected_us > 0 && next_us >= self.connected_us {
            self.connected_us = 0;
            let connected = !self.operator.has_unplugged;
            self.world().set_wire_connected(connected);
        }
        let time = self.time(next_us);
        self.operator.act(&mut self.laboratory.drive, time)?;
        if self.arms && time >= READY_TIMEOUT {
            self.arms = false;
        }
        let drive = &self.laboratory.drive;
        if self.arms && drive.mode() == Mode::Ready {
            let arm = PilotRequest::Arm(Arming::Unattended);
            self.arms = drive.request(arm).is_err();
        }
        let tick = self.laboratory.step()?.clone();
        self.take(&tick);
        Ok(())
    }

    /// Whether the run has reached its end. It can go on beyond, without rows.
    pub fn is_complete(&self) -> bool {
        let next_s = || self.time(self.laboratory.drive.next_tick_us());
        self.next_row > self.scenario.run.last_row()
            && (!self.takes_any_end || next_s() > self.until_s())
    }

    /// Until when a run goes on whose drive may end at any time, in s.
    fn until_s(&self) -> f64 {
        let ended_s = self.tally.ended_s();
        let after = ended_s.map_or(0.0, |ended_s| ended_s + AFTER_END);
        self.scenario.run.duration_s.max(after).max(self.least_s)
    }

    /// Goes on to the next tick or to the time of the next row, whichever is sooner; of a tick at
    /// the time of a row, to the tick.
    ///
    /// # Errors
    ///
    /// The record can't be written, or the operator's request is refused.
    pub fn advance(&mut self) -> Result<Progress, SimulateError> {
        if self.next_row > self.scenario.run.last_row() {
            self.step()?;
            return Ok(Progress::Tick);
        }
        let row_us = self.start_us + self.next_row * 1_000_000 / ROWS_PER_SECOND;
        if !self.laboratory.drive.advance_to(row_us) {
            self.step()?;
            return Ok(Progress::Tick);
        }
        let time = row_time(self.next_row);
        self.next_row += 1;
        let Some(last) = self.laboratory.last() else {
            // Before the first tick.
            return Ok(Progress::Tick);
        };
        let truth = if row_us == last.now.0 / 1_000 {
            last.truth
        } else {
            self.laboratory.drive.world.truth()
        };
        let output = &last.tick.output;
        let row = self.row(time, &truth, last);
        if drives(output.mode) {
            self.distances.push(row.distance_from_reference());
        } else if self.ended.is_none() {
            let reason = output.reason.map_or("no reason", Reason::name);
            self.ended = Some(format!(
                "the car no longer follows its reference from t = {time} s on: {}, {reason}",
                output.mode
            ));
        }
        Ok(Progress::Row(row))
    }

    /// Completes the record, and sums the run up. `rows` are those of [`ScenarioRun::advance`].
    ///
    /// # Errors
    ///
    /// The record can't be written.
    pub fn finish(mut self, rows: Vec<Row>) -> Result<Simulation, SimulateError> {
        self.laboratory.finish()?;
        let mut notes = Vec::new();
        let control = &self.scenario.control;
        if control.delay_ticks > 0 || control.steering == SteeringHold::Step {
            notes.push(
                "control.delay_ticks and control.steering are the ideal plant's; the car has its own \
                 delays, and a servo"
                    .to_owned(),
            );
        }
        notes.extend(self.ended);
        let distances = &self.distances;
        let tracking_error = TrackingError::of(distances);
        let later = TrackingError::of(&distances[distances.len() / 2..]);
        let estimates = self.calibration.as_ref();
        let estimates = estimates.map(|it| it.errors.estimates());
        let lines = estimates.into_iter().flatten();
        let summary = Summary {
            tracking_rms_m: later.map(|error| error.rms_m),
            calibration: lines.map(|one| CalibrationLine::from(&one)).collect(),
            ..self.tally.summary(tracking_error)
        };
        Ok(Simulation {
            rows,
            notes,
            tracking_error,
            summary: Some(summary),
            estimates: estimates.map_or_else(Vec::new, Vec::from),
            digest: self.laboratory.digest,
        })
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
