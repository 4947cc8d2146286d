//! The whole controller as one value: events of a tick in, one command out.

mod compensation;
mod events;
mod interface;
mod safety;
mod verdicts;

use libm::{cos, fabs, rint};
use singletrack_control::{
    Actuation, Ahead, Demand, Estimate, Estimator, LimitedLaw, OuterLoop, Position, Reference,
    ReferencePoint, Singularity, Time, TrackingInput, TrackingLoop, Velocity, front_point_velocity,
};

use crate::{
    event::{Event, Jog},
    refusal::SetpointRefusal,
    supervisor::{Conditions, Mode, Reason, Supervisor},
    watch::{
        AttitudeWatch, BlindWatch, FrozenWatch, GyroWatch, ImuWatch, InnovationWatch,
        PROVING_SPEED, Proving, PushWatch, SideslipWatch, SpeedWatch, StartWatch, SteeringWatch,
        Steps, StopWatch, TickWatch,
    },
};

use compensation::{Compensator, Course};
use safety::{LawStep, Safety};

pub use compensation::Compensation;
pub use interface::{DriveCommand, Output, PilotConfig, Underway};
pub use safety::Filtering;

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
    /// The velocity that P was given in the last tick, after every limit, m/s.
    applied: Velocity,
    /// None if the actuators are not compensated.
    compensator: Option<Compensator>,
    safety: Safety,
    estimator: Estimator,
    supervisor: Supervisor,
    imu: ImuWatch,
    speeds: SpeedWatch,
    ticks: TickWatch,
    blind: BlindWatch,
    stops: StopWatch,
    steps: Steps,
    sideslip: SideslipWatch,
    steering: SteeringWatch,
    gyro: GyroWatch,
    start: StartWatch,
    /// The operator's last pulses, in [`Mode::Jogging`].
    jog: Option<Jog>,
    /// Why a set-point of this tick is not obeyed.
    setpoint_refused: Option<SetpointRefusal>,
    /// The steering of the last command, rad: with the wave of the proving run.
    commanded_steering: f64,
    innovations: InnovationWatch,
    frozen: FrozenWatch,
    attitude: AttitudeWatch,
    push: PushWatch,
    /// Whether the configuration has been proved on this car.
    proved: bool,
    /// The comparison of the sensors; only in a drive of an unproved configuration.
    proving: Option<Proving>,
    /// When the board made its last record.
    board_time: Option<Time>,
    imu_time: Option<Time>,
    pose_time: Option<Time>,
    motor_speed: f64,
    drive_start: Option<Time>,
    last_tick: Option<Time>,
}

impl Pilot {
    /// A pilot before its first event: disconnected, without an estimate.
    #[must_use]
    pub fn new(config: PilotConfig) -> Self {
        Self {
            law: LimitedLaw::new(config.law, config.limits),
            tracking: config.tracking.clone(),
            applied: Velocity::zeros(),
            compensator: Compensator::of(&config.compensation),
            safety: Safety::new(config.safety.as_ref()),
            estimator: Estimator::new(config.estimator),
            supervisor: Supervisor::new(config.supervisor),
            imu: ImuWatch::default(),
            speeds: SpeedWatch::default(),
            ticks: TickWatch::default(),
            blind: BlindWatch::default(),
            stops: StopWatch::default(),
            steps: Steps::default(),
            sideslip: SideslipWatch::default(),
            steering: SteeringWatch::default(),
            gyro: GyroWatch::default(),
            start: StartWatch::default(),
            jog: None,
            setpoint_refused: None,
            commanded_steering: 0.0,
            innovations: InnovationWatch::default(),
            frozen: FrozenWatch::default(),
            attitude: AttitudeWatch::default(),
            push: PushWatch::default(),
            proved: false,
            proving: None,
            board_time: None,
            imu_time: None,
            pose_time: None,
            motor_speed: 0.0,
            drive_start: None,
            last_tick: None,
            config,
        }
    }

    /// Replaces the configuration from the next tick on. The state of board, line and
    /// requests is kept; the estimate restarts.
    ///
    /// # Errors
    ///
    /// [`Underway`] while a drive is underway; nothing changes then.
    pub fn reconfigure(&mut self, config: &PilotConfig) -> Result<(), Underway> {
        let mode = self.mode();
        if mode.is_underway() {
            return Err(Underway(mode));
        }
        self.config.clone_from(config);
        self.law = LimitedLaw::new(config.law, config.limits);
        self.tracking.clone_from(&config.tracking);
        self.compensator = Compensator::of(&config.compensation);
        self.safety = Safety::new(config.safety.as_ref());
        self.estimator = Estimator::new(config.estimator);
        self.supervisor.reconfigure(config.supervisor);
        self.speeds.reset();
        self.steps.reset();
        self.pose_time = None;
        Ok(())
    }

    /// `speed` (m/s of the host's clock) in the time of a board whose second lasts `rate` of the
    /// host's, for the command; within the limits of the speed. As it is if that is not
    /// compensated, and in the first metre of an unproved configuration.
    #[must_use]
    pub fn speed_for_board(&self, speed: f64, rate: f64) -> f64 {
        if !self.config.compensation.clock || self.proving.is_some() {
            return speed;
        }
        let limits = &self.config.limits;
        (speed * rate).clamp(-limits.max_reverse_speed, limits.max_speed)
    }

    /// `speed` (m/s) as such a board measures it, in the time of the host's clock.
    #[must_use]
    pub fn speed_of_board(&self, speed: f64, rate: f64) -> f64 {
        if self.config.compensation.clock {
            speed / rate
        } else {
            speed
        }
    }

    /// The mode after the last tick.
    #[must_use]
    pub const fn mode(&self) -> Mode {
        self.supervisor.mode()
    }

    /// Why the car does not drive, or stopped.
    #[must_use]
    pub const fn reason(&self) -> Option<Reason> {
        self.supervisor.reason()
    }

    /// One control tick: handles the events since the last tick, in their order, and
    /// returns the command until the next one.
    pub fn step<'a>(&mut self, now: Time, events: impl IntoIterator<Item = &'a Event>) -> Output {
        let mut held = true;
        self.setpoint_refused = None;
        for event in events {
            held &= !self.handle(now, event);
        }
        let last_tick = self.last_tick.replace(now);
        let steering = self.law.actuation().steering;
        let estimate = self.estimator.estimate(now, steering);
        if estimate.is_none() {
            self.pose_time = None;
        }
        let speed = estimate.map_or(0.0, |estimate| estimate.speed);
        if let Some(compensator) = &mut self.compensator {
            compensator.advance(now, speed);
        }
        // The largest of all speeds: estimated, measured and commanded.
        let pace = fabs(speed)
            .max(fabs(self.motor_speed))
            .max(fabs(self.law.actuation().speed));
        self.steps.tick(now, self.commanded_steering);
        self.attitude.tick(now);
        let speeds = self.speeds_at(now, estimate.as_ref());
        let (period, watch) = (self.config.period, &self.config.watch);
        self.blind.advance(now, pace);
        let (sent, braking) = (self.commanded_steering, self.braking());
        self.safety.observe(pace, sent, braking, period);
        self.ticks.tick(now, period, watch);
        let max_speed = self.config.limits.max_speed;
        let most = match &self.proving {
            Some(_) => max_speed.min(PROVING_SPEED),
            None => max_speed,
        };
        self.speeds.tick(speed, most, watch);
        let drive_time = self.drive_start.map(|start| now.seconds_since(start));
        let was = self.supervisor.mode();
        let mut request = self.supervisor.step(&Conditions {
            now,
            pose_time: self.pose_time,
            blind_distance: self.blind.distance(),
            poses: self.estimator.poses(),
            implausible: self.estimator.implausible_in_a_row(),
            imu_time: self.imu_time,
            imu: self.imu.verdict(self.estimator.gyro_bias(), watch),
            imu_still: self.imu.is_still(),
            speed,
            motor_speed: self.motor_speed,
            camera_speed: speeds.cameras,
            stands: speeds
                .worst()
                .is_some_and(|speed| speed < self.config.supervisor.standing_speed),
            preflight: self.preflight(),
            doubt: self.doubt(),
            implausible_motion: self.implausible_motion(),
            contradiction: self.contradiction(),
            speed_mismatch: self.speeds.is_mismatched(),
            overspeed: self.speeds.is_overspeed(),
            commanded_speed: self.law.actuation().speed,
            filter: self.safety.ends,
            inside_fence: estimate.is_none_or(|estimate| self.stops_inside(&estimate, pace)),
            late: self.ticks.is_late(watch),
            setpoint_stale: match &self.config.reference {
                Reference::External(external) => external.is_stale(now),
                _ => false,
            },
            reference_finished: match (drive_time, self.config.reference.duration()) {
                (Some(time), Some(duration)) => time >= duration,
                _ => false,
            },
        });
        let mode = self.supervisor.mode();
        if mode == Mode::Driving && was == Mode::Arming {
            self.drive_start = Some(now);
            self.law.reset();
            self.tracking.reset();
            self.applied = Velocity::zeros();
            if let Some(compensator) = &mut self.compensator {
                compensator.begin(self.law.actuation().steering);
            }
            self.safety.begin(self.commanded_steering);
            self.speeds.reset();
            self.sideslip.reset();
            self.steering.reset();
            self.gyro.reset();
            self.start.reset();
            self.innovations.reset();
            let unproved = self.config.supervisor.prove && !self.proved;
            self.proving = unproved.then(Proving::default);
        }
        if mode != Mode::Jogging || was != Mode::Jogging {
            // Pulses from before the board was armed do not count.
            self.jog = None;
        }
        let follows = |mode| matches!(mode, Mode::Driving | Mode::Slowing);
        if follows(mode) || mode == Mode::Jogging {
            self.stops.end();
        } else if was == Mode::Jogging {
            self.stops.begin_after_jogging(now, &speeds);
        } else if follows(was) {
            let commanded = if mode == Mode::Stopping {
                self.law.actuation().speed
            } else {
                0.0
            };
            self.stops.begin(now, &speeds, commanded);
        }
        if !mode.commands() {
            self.proving = None;
        }
        let stop = self.stops.tick(now, &speeds, &self.stop_limits());
        if stop.disobeyed {
            request = Some(self.supervisor.stop_not_obeyed(now));
        }
        let mode = self.supervisor.mode();
        if matches!(mode, Mode::Idle | Mode::Disconnected | Mode::Fault) {
            self.stand_by(was);
        }

        let mut output = Output {
            mode,
            reason: self.supervisor.reason(),
            estimate,
            held,
            drive_time: None,
            reference: None,
            point: None,
            point_velocity: None,
            actuation: self.law.actuation(),
            turning_round: false,
            looked_ahead: None,
            command: None,
            jog: self.jog,
            request,
            proved: false,
            disproved: false,
            braking_measured: stop.measured,
            preflight: self.supervisor.preflight(),
            setpoint: match &self.config.reference {
                Reference::External(external) => external.in_force(),
                _ => None,
            },
            setpoint_refused: self.setpoint_refused,
            filtering: Filtering::None,
            filtered_ticks: self.safety.ticks,
        };
        if let Some(estimate) = &estimate {
            let law = self.law.law();
            let wheels = self.wheels();
            output.point = Some(law.point(estimate.position, estimate.yaw, wheels));
            match mode {
                Mode::Driving => {
                    if let Err(reason) = self.drive(now, estimate, &mut output) {
                        request = Some(self.supervisor.fault(reason, now));
                        self.stops.begin(now, &speeds, 0.0);
                        self.proving = None;
                        self.stand_by(mode);
                        output.mode = self.supervisor.mode();
                        output.reason = self.supervisor.reason();
                        output.preflight = self.supervisor.preflight();
                        output.command = None;
                        output.request = request;
                    }
                }
                Mode::Slowing | Mode::Stopping => {
                    // Ticks that are late or left out must not make the stop longer.
                    let elapsed = last_tick.map_or(period, |last| now.seconds_since(last));
                    let periods = rint(elapsed / period).max(1.0);
                    let actuation = self
                        .law
                        .slow_down(self.config.stop_deceleration, periods * period);
                    // P leaves its reference here; a drive that goes on begins to follow anew.
                    self.tracking.reset();
                    self.applied = self.given_by(estimate, &actuation);
                    output.drive_time = self.drive_start.map(|start| now.seconds_since(start));
                    output.actuation = actuation;
                    output.command = Some(command(estimate, &actuation, true));
                }
                Mode::Disconnected
                | Mode::Idle
                | Mode::Ready
                | Mode::Arming
                | Mode::Fault
                | Mode::Jogging => {}
            }
        }
        self.commanded_steering = output
            .command
            .map_or(output.actuation.steering, |command| command.steering);
        if let Some(compensator) = &mut self.compensator {
            compensator.commanded(now, self.commanded_steering);
        }
        let contradicted =
            self.supervisor.is_contradicted() || self.stops.is_too_weak(self.config.braking);
        if self.proved && contradicted {
            self.proved = false;
            output.disproved = true;
        }
        output
    }

    /// A tick in [`Mode::Driving`]: reference, position loop and law, or the actuation that a
    /// controller outside demands. Fails where the law is singular.
    fn drive(&mut self, now: Time, estimate: &Estimate, output: &mut Output) -> Result<(), Reason> {
        let time = self
            .drive_start
            .map_or(0.0, |start| now.seconds_since(start));
        let before = self.law.actuation().speed;
        let actuation = match self.config.reference.demand(now, time) {
            Demand::Point(reference) => {
                output.reference = Some(reference);
                self.follow(now, time, &reference, estimate, output)
            }
            Demand::Actuation { steering, speed } => {
                self.tracking.reset();
                self.step_demand(estimate, steering, speed)
            }
        }
        .map_err(|_| match &self.proving {
            Some(proving) if proving.moves_across() => Reason::BodyYawWrong,
            _ => Reason::LawSingular,
        })?;
        // Without a fresh pose the car must not accelerate.
        let actuation = if estimate.pose_age() > self.config.supervisor.fresh {
            self.law.cap_speed(fabs(before));
            self.law.actuation()
        } else {
            actuation
        };
        let (actuation, coast, wave) = self.prove(now, estimate, actuation, output);
        self.applied = match output.reference {
            Some(_) => self.law.point_velocity(),
            None => self.given_by(estimate, &actuation),
        };
        if let Some(compensator) = &mut self.compensator {
            compensator.sent(actuation.speed);
        }
        output.drive_time = Some(time);
        output.actuation = actuation;
        output.turning_round = self.law.is_turning_round();
        (output.filtering, output.filtered_ticks) = (self.safety.filtering, self.safety.ticks);
        let mut command = command(estimate, &actuation, false);
        if coast {
            command.rear_speed = 0.0;
        }
        if wave != 0.0 {
            let most = self.config.limits.max_steering;
            command.steering = (command.steering + wave).clamp(-most, most);
        }
        output.command = Some(command);
        Ok(())
    }

    /// The velocity (m/s) that a command gives P which the law has not computed.
    fn given_by(&self, estimate: &Estimate, actuation: &Actuation) -> Velocity {
        front_point_velocity(
            self.law.law(),
            &estimate.motion(),
            self.wheels(),
            actuation.speed,
            actuation.steering_rate,
        )
    }

    /// The angle of the front wheels, as far as is known, in rad.
    fn wheels(&self) -> f64 {
        let commanded = self.law.actuation().steering;
        self.compensator
            .as_ref()
            .filter(|_| self.proving.is_none())
            .map_or(commanded, Compensator::wheels)
    }

    /// The actuation with which P follows its reference.
    fn follow(
        &mut self,
        now: Time,
        time: f64,
        reference: &ReferencePoint,
        estimate: &Estimate,
        output: &mut Output,
    ) -> Result<Actuation, Singularity> {
        let config = &self.config;
        let (limits, period) = (&config.limits, config.period);
        let law = *self.law.law();
        // What the first metre proves does not rest on a model; and the law would take the wave
        // of its steering for its own.
        let compensator = self.compensator.as_mut();
        let Some(compensator) = compensator.filter(|_| self.proving.is_none()) else {
            let steering = self.law.actuation().steering;
            let point = law.point(estimate.position, estimate.yaw, steering);
            let velocity = self.tracking.step(&TrackingInput {
                point,
                reference: &|ahead| {
                    let point = config.reference.point_ahead(now, time, ahead);
                    point.unwrap_or(*reference)
                },
                applied: self.applied,
                period,
            });
            let ahead = Ahead {
                overtaken: overtaken(reference, &point),
                lead: None,
            };
            let step = LawStep {
                motion: estimate.motion(),
                wheels: steering,
                ahead,
            };
            return self.step_law(estimate, &step, &velocity, output);
        };
        let course = Course {
            law: &law,
            reference: &config.reference,
            max_speed: limits.max_speed,
            max_steering_rate: limits.max_steering_rate,
            max_acceleration: limits.max_acceleration,
            now,
            time,
            period,
        };
        let (tracking, measured) = (&mut self.tracking, self.imu_time);
        let (state, velocity, lead) =
            compensator.look_ahead(estimate, measured, &course, tracking, self.applied)?;
        output.looked_ahead = Some(state.ahead);
        let point = law.point(state.position, state.motion.yaw, state.wheels);
        let ahead = Ahead {
            overtaken: overtaken(reference, &point),
            lead: Some(lead),
        };
        let step = LawStep {
            motion: state.motion,
            wheels: state.wheels,
            ahead,
        };
        self.step_law(estimate, &step, &velocity, output)
    }

    /// A tick of the proving run: limits the speed, and returns whether the car is to roll at
    /// neutral and what to add to the steering. Without one, nothing changes.
    fn prove(
        &mut self,
        now: Time,
        estimate: &Estimate,
        actuation: Actuation,
        output: &mut Output,
    ) -> (Actuation, bool, f64) {
        let Some(proving) = &mut self.proving else {
            return (actuation, false, 0.0);
        };
        let start_judged = self.start.is_judged();
        let tick = proving.tick(now, estimate.speed, self.config.braking, start_judged);
        if tick.coast {
            // The drive goes on from the speed to which the car has rolled.
            self.law.cap_speed(fabs(estimate.speed));
        }
        self.law.cap_speed(PROVING_SPEED);
        if let Some(measured) = tick.coasted {
            self.stops.coasted(measured);
            output.braking_measured = Some(measured);
        }
        if tick.passed {
            self.proved = true;
            self.proving = None;
            output.proved = true;
        }
        (self.law.actuation(), tick.coast, tick.steering)
    }

    /// Ends the drive: clears its start and the state of the law, and keeps the reason.
    fn stand_by(&mut self, was: Mode) {
        self.drive_start = None;
        self.law.reset();
        // While the car stands, the estimate may restart: it has lost the car if the last
        // pose was implausible.
        let lost = self.estimator.implausible_in_a_row() > 0;
        if lost && !was.commands() {
            self.estimator.reset();
        }
    }
}

/// The longest time for which a car waits for the reference that its P has overtaken, s.
const OVERTAKEN: f64 = 1.0;

/// The velocity of a reference that comes after `point` soon, for the law.
fn overtaken(reference: &ReferencePoint, point: &Position) -> Option<Velocity> {
    let away = (reference.position? - point).norm();
    let is_near = away < OVERTAKEN * reference.velocity.norm();
    is_near.then_some(reference.velocity)
}

/// The command for the board. The motor drives the rear axle, whose speed is the forward
/// component of G's: v cos β.
fn command(estimate: &Estimate, actuation: &Actuation, brake: bool) -> DriveCommand {
    DriveCommand {
        rear_speed: actuation.speed * cos(estimate.sideslip),
        steering: actuation.steering,
        pose_time: estimate.pose_time,
        brake,
    }
}
