//! The whole controller as one value: events of a tick in, one command out.

mod act;
mod compensation;
mod interface;
mod judge;
mod safety;
mod sense;
mod watches;

use singletrack_control::{
    Estimate, Estimator, Governor, LimitedLaw, Reference, Time, TrackingLoop, Velocity,
};

use crate::{
    event::{Event, Jog},
    learned::{Learned, Learning},
    supervisor::{Mode, Reason, Supervisor},
};

use compensation::Compensator;
use safety::{Obstacles, Safety};
use watches::Watches;

pub use compensation::Compensation;
pub use interface::{DriveCommand, Output, PilotConfig, SetpointRefusal, Underway};
pub use safety::Filtering;
pub use sense::{Commanded, Imu, Observed};

/// Estimator, supervisor, outer loop, law and limits as one deterministic value.
///
/// It reads no clock: the same configuration and the same events at the same ticks give
/// the same outputs, bit for bit.
#[derive(Clone, Debug)]
pub struct Pilot {
    config: PilotConfig,
    law: LimitedLaw,
    /// With its state; the configuration's has none yet.
    tracking: TrackingLoop,
    /// The place for its copy, of which a tick takes steps into the future.
    imagined: TrackingLoop,
    /// The velocity that P was given in the last tick, after every limit, m/s.
    applied: Velocity,
    /// None if the reference is followed as it is.
    governor: Option<Governor>,
    /// None if the actuators are not compensated.
    compensator: Option<Compensator>,
    safety: Safety,
    obstacles: Obstacles,
    /// The time of the drive by which its reference is later, s.
    waited: f64,
    /// The share of the tick's period by which the reference waits.
    delay: f64,
    /// None if it does not learn.
    learning: Option<Learning>,
    /// Where p goes to, in m; the law has the one of now.
    wanted_point_distance: f64,
    estimator: Estimator,
    /// What is taken for the estimate of the next tick.
    assumed: Option<Estimate>,
    supervisor: Supervisor,
    watches: Watches,
    /// The operator's last pulses, in [`Mode::Jogging`].
    jog: Option<Jog>,
    /// Why a set-point of this tick is not obeyed.
    setpoint_refused: Option<SetpointRefusal>,
    /// The steering of the last command, rad: with the wave of the proving run.
    commanded_steering: f64,
    /// Whether the configuration has been proved on this car.
    proved: bool,
    /// When the board last measured the motor, if its last record says it.
    motor_time: Option<Time>,
    /// What the car has of an IMU: all of it, unless it is only observed.
    imu: Imu,
    /// When the IMU last gave a sample, and one that is possible.
    imu_heard: Option<Time>,
    imu_time: Option<Time>,
    /// What that sample's gyro read, rad/s.
    gyro: f64,
    pose_time: Option<Time>,
    motor_speed: f64,
    drive_start: Option<Time>,
    begins: Begins,
    last_tick: Option<Time>,
}

/// When an armed car begins to follow its reference.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Begins {
    AtOnce,
    /// When [`Event::Begin`] comes.
    Later,
    At(Time),
}

impl Pilot {
    /// A pilot before its first event: disconnected, without an estimate.
    pub fn new(config: PilotConfig) -> Self {
        Self {
            law: LimitedLaw::new(config.law, config.limits),
            tracking: config.tracking.clone(),
            imagined: config.tracking.clone(),
            applied: Velocity::zeros(),
            governor: config.governor(),
            compensator: Compensator::of(&config.compensation),
            safety: Safety::new(config.safety.as_ref()),
            obstacles: Obstacles::new(config.neighbours.as_ref()),
            waited: 0.0,
            delay: 0.0,
            learning: config.learns.then(Learning::default),
            wanted_point_distance: config.law.point_distance(),
            estimator: Estimator::new(config.estimator),
            assumed: None,
            supervisor: Supervisor::new(config.supervisor),
            watches: Watches::default(),
            jog: None,
            setpoint_refused: None,
            commanded_steering: 0.0,
            proved: false,
            motor_time: None,
            imu: Imu::Whole,
            imu_heard: None,
            imu_time: None,
            gyro: 0.0,
            pose_time: None,
            motor_speed: 0.0,
            drive_start: None,
            begins: Begins::AtOnce,
            last_tick: None,
            config,
        }
    }

    /// Replaces the configuration from the next tick on. The state of board, line and
    /// requests is kept; the estimate restarts. A tuned value stays unless the configuration
    /// has another value or other bounds for it.
    ///
    /// # Errors
    ///
    /// [`Underway`] while a drive is underway; nothing changes then.
    pub fn reconfigure(&mut self, config: &PilotConfig) -> Result<(), Underway> {
        let mode = self.mode();
        if mode.is_underway() {
            return Err(Underway(mode));
        }
        let kept = self.kept_tuning(config);
        self.config.clone_from(config);
        self.law = LimitedLaw::new(config.law, config.limits);
        self.tracking.assign(&config.tracking);
        self.imagined.assign(&config.tracking);
        self.wanted_point_distance = config.law.point_distance();
        self.keep_tuning(&kept);
        self.governor = config.governor();
        self.compensator = Compensator::of(&config.compensation);
        self.safety = Safety::new(config.safety.as_ref());
        self.obstacles = Obstacles::new(config.neighbours.as_ref());
        self.learning = config.learns.then(Learning::default);
        self.estimator.reconfigure(config.estimator);
        self.supervisor.reconfigure(config.supervisor);
        self.watches.reset();
        self.pose_time = None;
        Ok(())
    }

    /// `speed` (m/s of the host's clock) in the time of a board whose second lasts `rate` of the
    /// host's, for the command; within the limits of the speed. As it is if that is not
    /// compensated, and in the first metre of an unproved configuration.
    pub fn speed_for_board(&self, speed: f64, rate: f64) -> f64 {
        if !self.config.compensation.clock || self.watches.proving.is_some() {
            return speed;
        }
        let limits = &self.config.limits;
        (speed * rate).clamp(-limits.max_reverse_speed, limits.max_speed)
    }

    /// `speed` (m/s) as such a board measures it, in the time of the host's clock.
    pub fn speed_of_board(&self, speed: f64, rate: f64) -> f64 {
        if self.config.compensation.clock {
            speed / rate
        } else {
            speed
        }
    }

    /// The mode after the last tick.
    pub const fn mode(&self) -> Mode {
        self.supervisor.mode()
    }

    /// The corrections in force; `None` if it does not learn.
    pub fn learned(&self) -> Option<Learned> {
        Some(self.learning?.in_force)
    }

    /// Why the car does not drive, or stopped.
    pub const fn reason(&self) -> Option<Reason> {
        self.supervisor.reason()
    }

    /// One control tick: handles the events since the last tick, in their order, and
    /// returns the command until the next one. It senses the present, judges whether the car may
    /// drive, and acts.
    pub fn step<'a>(&mut self, now: Time, events: impl IntoIterator<Item = &'a Event>) -> Output {
        let sensed = self.sense(now, events, None, |_, _, _| {});
        let verdict = self.judge(&sensed);
        let (output, singular) = self.act(&sensed);
        let fault = singular.map(|reason| self.fault(reason, &sensed));
        self.commanded_steering = output
            .command
            .map_or(output.actuation.steering, |command| command.steering);
        let sent = self.commanded_steering;
        let wheels = self.learning.map_or(sent, |it| it.in_force.wheels(sent));
        self.estimator.send(now, wheels);
        if let Some(compensator) = &mut self.compensator {
            compensator.predictor.commanded(now, wheels);
        }
        let is_too_weak = self.watches.stops.is_too_weak(self.config.braking);
        let disproved = self.proved && (self.supervisor.is_contradicted() || is_too_weak);
        self.proved &= !disproved;
        let estimate = sensed.estimate.filter(|_| sensed.is_measured);
        Output {
            mode: self.supervisor.mode(),
            reason: self.supervisor.reason(),
            estimate,
            covariance: estimate.and(self.estimator.covariance()),
            held: sensed.held,
            point: output.point.filter(|_| sensed.is_measured),
            jog: self.jog,
            request: fault.or(verdict.request),
            disproved,
            braking_measured: output.braking_measured.or(verdict.braking_measured),
            preflight: self.supervisor.preflight(),
            setpoint: match &self.config.reference {
                Reference::External(external) => external.in_force(),
                _ => None,
            },
            setpoint_refused: self.setpoint_refused,
            tuned: self.tuned(),
            ..output
        }
    }
}
