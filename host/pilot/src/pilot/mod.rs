//! The whole controller as one value: events of a tick in, one command out.

mod act;
mod compensation;
mod judge;
mod safety;
mod sense;
mod watches;

use singletrack_control::{
    Actuation, Covariance, Estimate, Estimator, EstimatorConfig, FrontPointLaw, Governor,
    GovernorConfig, LimitedLaw, Limits, NeighbourConfig, Position, Reference, ReferencePoint,
    SafetyFilter, SetpointError, SetpointStamp, SlowedBy, Start, Time, TrackingLoop, Velocity,
    words,
};

use crate::{
    event::{Event, Jog},
    fence::Fence,
    learned::{Learned, Learning},
    supervisor::{BoardRequest, Mode, Reason, Supervisor, SupervisorConfig},
    tuning::{Tuned, TuningBounds},
    watch::WatchConfig,
};

use compensation::Compensator;
use safety::{Obstacles, Safety};
use watches::Watches;

pub use compensation::Compensation;
pub use safety::Filtering;
pub use sense::{Commanded, Imu, Observed};

/// The configuration of a [`Pilot`], in SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct PilotConfig {
    /// The law, with p and the assumed `l_f`.
    pub law: FrontPointLaw,
    /// The position loop.
    pub tracking: TrackingLoop,
    /// The path of P; its time counts from the first driving tick.
    pub reference: Reference,
    /// Where a drive begins on it.
    pub start: Start,
    /// Makes the reference slower or wider where the car can't follow it; none to follow it as
    /// it is.
    pub governor: Option<GovernorConfig>,
    /// Limits of speed, acceleration and steering.
    pub limits: Limits,
    /// Parameters of the estimator.
    pub estimator: EstimatorConfig,
    /// The limits at which the car slows down or stops.
    pub supervisor: SupervisorConfig,
    /// The limits of plausible sensors and of tick timing.
    pub watch: WatchConfig,
    /// The geofence.
    pub fence: Fence,
    /// The measured deceleration of the car during a stop, m/s². It bounds the braking
    /// distance: a motor at neutral may brake less than `stop_deceleration` commands.
    pub braking: f64,
    /// The commanded deceleration of a stop, m/s².
    pub stop_deceleration: f64,
    /// What is compensated of clocks and actuators.
    pub compensation: Compensation,
    /// The filter between any outer loop and the law, before its first tick; none if what they
    /// want passes as it is.
    pub safety: Option<SafetyFilter>,
    /// What is expected of other rigid bodies; none if the car does not keep apart from them.
    pub neighbours: Option<NeighbourConfig>,
    /// What may be tuned while the pilot runs, and within which bounds; none if nothing may.
    pub tuning: Option<TuningBounds>,
    /// Whether it corrects what it acts on by what is learned while the car drives. The safety
    /// filter rests on the configured steering: with one, this must be false.
    pub learns: bool,
    /// The control period, s.
    pub period: f64,
}

impl PilotConfig {
    /// The governor of the reference, at its start; none where that is off, and for a reference
    /// of which P does not have a position at every time.
    pub fn governor(&self) -> Option<Governor> {
        let governor = self.governor.as_ref()?;
        let is_path = self.reference.at(0.0).position.is_some();
        is_path.then(|| Governor::new(governor.clone()))
    }
}

/// A command to the board, in force until the next tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveCommand {
    /// Speed of the rear axle, m/s.
    pub rear_speed: f64,
    /// Steering angle, rad; positive to the left.
    pub steering: f64,
    /// Mid-exposure of the last accepted pose that the command rests on.
    pub pose_time: Time,
    /// Whether the ESC should brake down to the speed, where it can.
    pub brake: bool,
}

/// The result of a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// The mode after the tick.
    pub mode: Mode,
    /// Why the car does not drive, or stopped.
    pub reason: Option<Reason>,
    /// The estimated state that the tick acted on; `None` also while neither poses nor the motor
    /// measure it.
    pub estimate: Option<Estimate>,
    /// The covariances of `estimate`.
    pub covariance: Option<Covariance>,
    /// Whether no pose was accepted since the last tick.
    pub held: bool,
    /// Time since the first driving tick, s; `None` outside a drive.
    pub drive_time: Option<f64>,
    /// Wanted position and velocity of P, from the reference.
    pub reference: Option<ReferencePoint>,
    /// Position of P, from the estimate and the commanded steering.
    pub point: Option<Position>,
    /// Wanted velocity of P after the position loop, m/s.
    pub point_velocity: Option<Velocity>,
    /// Speed of G and steering, after the limits.
    pub actuation: Actuation,
    /// Whether the car turns around to a wanted velocity behind it.
    pub turning_round: bool,
    /// How far ahead the state was predicted to which the command belongs, s; `None` if the
    /// actuators are not compensated, and outside a drive.
    pub looked_ahead: Option<f64>,
    /// The path parameter of the reference, s: the time of the drive, unless a governor has
    /// slowed the reference down; `None` outside a drive.
    pub path: Option<f64>,
    /// Why the reference is slowed down, or led beside its path.
    pub slowed_by: Option<SlowedBy>,
    /// The drive command for the board.
    pub command: Option<DriveCommand>,
    /// The pulses for the board, in [`Mode::Jogging`].
    pub jog: Option<Jog>,
    /// The request to the board.
    pub request: Option<BoardRequest>,
    /// Whether the car has proved its configuration in this tick: the first metre showed
    /// no contradiction.
    pub proved: bool,
    /// Whether the configuration counts as proved no longer, since this tick: a contradiction
    /// ended the drive, or the brakes are too weak.
    pub disproved: bool,
    /// The deceleration of the stop that ended in this tick, m/s²; `None` also if motor and cameras
    /// were both lost meanwhile.
    pub braking_measured: Option<f64>,
    /// Why an arm request would be refused now; `None` if it would not, or while a drive is
    /// underway. Unlike `reason`, it never says why the last drive ended.
    pub preflight: Option<Reason>,
    /// The newest set-point from outside that was not refused.
    pub setpoint: Option<SetpointStamp>,
    /// Why a set-point that came in this tick is not obeyed; of several the newest.
    pub setpoint_refused: Option<SetpointRefusal>,
    /// What the safety filter did in this tick.
    pub filtering: Filtering,
    /// The number of ticks of the drive, or of the last one, in which it did anything.
    pub filtered_ticks: u32,
    /// The values in force of what can be tuned; none if nothing can.
    pub tuned: Option<Tuned>,
}

impl Output {
    /// The output of a pilot that has no estimate and commands nothing.
    pub fn neutral(mode: Mode) -> Self {
        Self {
            mode,
            held: true,
            ..Self::default()
        }
    }
}

/// The configuration was not replaced because a drive is underway, in this mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the car drives (mode {0}): disarm it first")]
pub struct Underway(pub Mode);

words! {
    /// Why the pilot does not obey a set-point that reached it.
    pub enum SetpointRefusal {
        /// A value is infinite or not a number.
        NotFinite = 1 "not-finite",
        /// A value is beyond that of any car, or a trajectory is not one.
        OutOfRange = 2 "out-of-range",
        /// It was decided later than the tick.
        Future = 3 "future",
        /// It is older than the time-out, or its trajectory is over.
        Old = 4 "old",
        /// One that was decided later is in force.
        Superseded = 5 "superseded",
        /// Points of the trajectory are missing.
        Incomplete = 6 "incomplete",
        /// The reference in force takes no set-points.
        NotExternal = 7 "not-external",
    }
}

impl From<SetpointError> for SetpointRefusal {
    fn from(error: SetpointError) -> Self {
        match error {
            SetpointError::NotFinite => Self::NotFinite,
            SetpointError::OutOfRange(_) => Self::OutOfRange,
            SetpointError::Future => Self::Future,
            SetpointError::Old => Self::Old,
            SetpointError::Superseded => Self::Superseded,
            SetpointError::Incomplete => Self::Incomplete,
        }
    }
}

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
