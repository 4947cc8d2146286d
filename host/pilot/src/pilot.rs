//! The whole controller as one value: events of a tick in, one command out.

use core::f64::consts::PI;

use libm::{copysign, cos, fabs, rint, sin, tan};
use singletrack_control::{
    Actuation, Demand, Estimate, Estimator, EstimatorConfig, FrontPointLaw, LimitedLaw, Limits,
    OuterLoop, PoseSample, PoseVerdict, Position, Reference, ReferencePoint, SetpointStamp, Time,
    TrackingLoop, Velocity, direction,
};

use crate::{
    event::{BoardSample, Event, Jog},
    fence::Fence,
    supervisor::{BoardRequest, Conditions, Mode, Reason, Supervisor, SupervisorConfig},
    watch::{
        AttitudeWatch, BlindWatch, FrozenWatch, ImuWatch, InnovationWatch, PROVING_SPEED, Proving,
        PushWatch, SideslipWatch, SpeedWatch, Speeds, StartWatch, SteeringWatch, Steps, StopLimits,
        StopWatch, TickWatch, WatchConfig,
    },
};

/// The configuration of a [`Pilot`], in SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct PilotConfig {
    /// The law, with p and the assumed `l_f`.
    pub law: FrontPointLaw,
    /// The position loop.
    pub tracking: TrackingLoop,
    /// The path of P; its time counts from the first driving tick.
    pub reference: Reference,
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
    /// The control period, s.
    pub period: f64,
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
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// The mode after the tick.
    pub mode: Mode,
    /// Why the car does not drive, or stopped.
    pub reason: Option<Reason>,
    /// The estimated state that the tick acted on.
    pub estimate: Option<Estimate>,
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
    /// The deceleration of the stop that ended in this tick, m/s².
    pub braking_measured: Option<f64>,
    /// Why an arm request would be refused now; `None` if it would not, or while a drive is
    /// underway. Unlike `reason`, it never says why the last drive ended.
    pub preflight: Option<Reason>,
    /// The newest set-point from outside that was not refused.
    pub setpoint: Option<SetpointStamp>,
}

/// The configuration was not replaced because a drive is underway, in this mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the car drives (mode {0}): disarm it first")]
pub struct Underway(pub Mode);

/// The time from the decision to stop until the car decelerates, s: a tick, the board
/// and the lag of the motor.
const REACTION: f64 = 0.1;

/// The deceleration assumed of an unproved car, m/s²: that of one that rolls well.
const UNPROVED_BRAKING: f64 = 0.25;

/// The longest age of telemetry whose motor speed counts, s.
const MOTOR_RECENT: f64 = 0.2;

/// The lowest speed at which yaw rate over speed gives the curvature, m/s.
const BENDS_FROM: f64 = 0.1;

/// Estimator, supervisor, outer loop, law and limits as one deterministic value.
///
/// It reads no clock: the same configuration and the same events at the same ticks give
/// the same outputs, bit for bit.
#[derive(Clone, Debug)]
pub struct Pilot {
    config: PilotConfig,
    law: LimitedLaw,
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
    start: StartWatch,
    /// The operator's last pulses, in [`Mode::Jogging`].
    jog: Option<Jog>,
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
            start: StartWatch::default(),
            jog: None,
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
        self.estimator = Estimator::new(config.estimator);
        self.supervisor.reconfigure(config.supervisor);
        self.speeds.reset();
        self.steps.reset();
        self.pose_time = None;
        Ok(())
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
        // The largest of all speeds: estimated, measured and commanded.
        let pace = fabs(speed)
            .max(fabs(self.motor_speed))
            .max(fabs(self.law.actuation().speed));
        self.steps.tick(now, self.commanded_steering);
        self.attitude.tick(now);
        let speeds = self.speeds_at(now, estimate.as_ref());
        let (period, watch) = (self.config.period, &self.config.watch);
        self.blind.advance(now, pace);
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
            self.speeds.reset();
            self.sideslip.reset();
            self.steering.reset();
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
        };
        if let Some(estimate) = &estimate {
            let law = self.law.law();
            output.point = Some(law.point(estimate.position, estimate.yaw, steering));
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
        let contradicted =
            self.supervisor.is_contradicted() || self.stops.is_too_weak(self.config.braking);
        if self.proved && contradicted {
            self.proved = false;
            output.disproved = true;
        }
        output
    }

    /// A tick in [`Mode::Driving`]: reference, position loop, law, or the actuation that a
    /// controller outside demands. Fails where the law is
    /// singular.
    fn drive(&mut self, now: Time, estimate: &Estimate, output: &mut Output) -> Result<(), Reason> {
        let time = self
            .drive_start
            .map_or(0.0, |start| now.seconds_since(start));
        let point = self.law.law().point(
            estimate.position,
            estimate.yaw,
            self.law.actuation().steering,
        );
        let before = self.law.actuation().speed;
        let period = self.config.period;
        let actuation = match self.config.reference.demand(now, time) {
            Demand::Point(reference) => {
                let velocity = self.config.tracking.velocity(&reference, &point);
                output.reference = Some(reference);
                output.point_velocity = Some(velocity);
                self.law
                    .step(&estimate.motion(), estimate.speed, &velocity, period)
            }
            Demand::Actuation { steering, speed } => self.law.follow(steering, speed, period),
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
        output.drive_time = Some(time);
        output.actuation = actuation;
        output.turning_round = self.law.is_turning_round();
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

    /// What forbids to arm, by the watches.
    fn preflight(&self) -> Option<Reason> {
        let marker_yaw = self.config.estimator.marker_yaw;
        self.attitude
            .check(marker_yaw, &self.config.watch)
            .or(match () {
                () if self.push.is_wrong() => Some(Reason::BodyYawWrong),
                () if self.stops.is_too_weak(self.config.braking) => {
                    Some(Reason::BrakesLessThanConfigured)
                }
                () => None,
            })
    }

    /// What forbids to arm and to drive, by the watches.
    const fn doubt(&self) -> Option<Reason> {
        if self.frozen.is_frozen() {
            Some(Reason::PoseFrozen)
        } else if self.attitude.is_uncertain() {
            Some(Reason::CaptureTimeUncertain)
        } else {
            None
        }
    }

    /// What ends a drive, by the watches.
    fn implausible_motion(&self) -> Option<Reason> {
        let watch = &self.config.watch;
        let [forward, left] = self.estimator.acceleration_bias();
        if self.sideslip.is_exceeded() {
            Some(Reason::SideslipImplausible)
        } else if self.steering.is_exceeded() {
            Some(Reason::SteeringDiffers)
        } else if self.start.differs()
            || fabs(forward).max(fabs(left)) > watch.max_acceleration_bias
        {
            Some(Reason::AccelerometerDiffers)
        } else if self.innovations.is_inconsistent() {
            Some(Reason::EstimateInconsistent)
        } else {
            None
        }
    }

    /// What contradicts in the drive of an unproved configuration: what the comparison finds,
    /// and whatever the watches of every drive find before it.
    fn contradiction(&self) -> Option<Reason> {
        let proving = self.proving.as_ref()?;
        let mismatch = self.speeds.is_mismatched();
        proving
            .found()
            .or_else(|| self.implausible_motion())
            .or(mismatch.then_some(Reason::MotorSpeedMismatch))
    }

    fn speeds_at(&self, now: Time, estimate: Option<&Estimate>) -> Speeds {
        let heard = self
            .board_time
            .is_some_and(|time| now.seconds_since(time) <= MOTOR_RECENT);
        Speeds {
            motor: heard.then_some(self.motor_speed),
            cameras: self.steps.camera_speed(now),
            estimate: estimate.map(|estimate| estimate.speed),
        }
    }

    const fn stop_limits(&self) -> StopLimits {
        StopLimits {
            braking: self.config.braking,
            ramp: self.config.stop_deceleration,
            standing: self.config.supervisor.standing_speed,
        }
    }

    /// The deceleration that the geofence relies on, m/s²: as configured or as measured,
    /// whichever is lower.
    fn braking(&self) -> f64 {
        let known = self.config.braking.min(self.stops.lowest().max(0.05));
        if self.proving.is_some() {
            known.min(UNPROVED_BRAKING)
        } else {
            known
        }
    }

    /// Handles an event; true if it is a pose and was accepted.
    fn handle(&mut self, now: Time, event: &Event) -> bool {
        match event {
            Event::Pose(pose) => return self.handle_pose(pose),
            Event::PoseMissing(missing) => self.supervisor.handle_pose_missing(*missing),
            Event::Board(sample) => self.handle_board(sample),
            Event::Link(link) => self.supervisor.handle_link(*link),
            Event::Request(request) => self.supervisor.handle_request(*request),
            Event::ArmRefused => self.supervisor.handle_arm_refused(),
            Event::Health(health) => self.supervisor.handle_health(*health),
            Event::Line(line) => self.supervisor.handle_line(*line),
            Event::RealTime(state) => self.supervisor.handle_real_time(*state),
            // Without a set-point that it does not refuse, the reference becomes stale.
            Event::Setpoint(setpoint) => {
                if let Reference::External(external) = &mut self.config.reference {
                    external.handle(setpoint, now).ok();
                }
            }
            Event::TrajectoryPiece(piece) => {
                if let Reference::External(external) = &mut self.config.reference {
                    external.handle_piece(piece, now).ok();
                }
            }
            Event::Jog(jog) => {
                self.supervisor.handle_jog();
                self.jog = Some(*jog);
            }
            Event::Attitude(sample) => self.attitude.handle(sample, &self.config.watch),
            Event::Proved(proved) => self.proved = *proved,
            // The caller has called `reconfigure` before this tick.
            Event::Reconfigured(_) => {}
        }
        false
    }

    fn handle_pose(&mut self, pose: &PoseSample) -> bool {
        self.frozen.pose(pose, &self.config.watch);
        let accepted = self.estimator.handle_pose(pose) == PoseVerdict::Accepted;
        if accepted {
            self.innovations
                .pose(self.estimator.innovation(), &self.config.watch);
            self.pose_time = Some(pose.capture);
            self.supervisor.handle_pose();
            self.blind.seen(pose.capture);
            let centre = self.estimator.centre_of_mass(pose);
            self.speeds.pose(
                pose.capture,
                centre.position,
                centre.yaw,
                &self.config.watch,
            );
            let config = &self.config;
            let rear_axle = config.estimator.rear_axle_distance;
            let step = self
                .steps
                .pose(pose.capture, centre.position, centre.yaw, rear_axle);
            if let Some(step) = step {
                if matches!(self.supervisor.mode(), Mode::Driving | Mode::Slowing) {
                    let wheelbase = config.estimator.wheelbase;
                    self.start.step(&step);
                    self.sideslip.step(&step, &config.watch);
                    self.steering.step(&step, wheelbase, &config.watch);
                    if let Some(proving) = &mut self.proving {
                        proving.step(&step, wheelbase, config.watch.pulse_distance);
                    }
                } else if self.supervisor.mode() != Mode::Jogging {
                    self.push.step(&step);
                }
            }
        }
        accepted
    }

    /// Whether the car is inside the geofence, and stays inside if it stops now.
    ///
    /// The path ahead is the distance since the last pose, the reaction distance and the
    /// braking distance v²/2a, at the speed `pace` (m/s). A stop holds the steering, so the
    /// path follows the commanded curvature; and the present one, from which the wheels turn
    /// there.
    fn stops_inside(&self, estimate: &Estimate, pace: f64) -> bool {
        let braking = 0.5 * pace * pace / self.braking();
        let ahead = self.blind.distance() + pace * REACTION + braking;
        let present = if fabs(estimate.speed) > BENDS_FROM {
            estimate.yaw_rate / estimate.speed
        } else {
            0.0
        };
        let commanded = tan(self.commanded_steering) / self.config.estimator.wheelbase;
        let way = |curvature: f64, distance: f64| {
            let distance = copysign(distance, estimate.speed);
            // The arc turns by this angle; its chord is sin(turn/2)/(turn/2) as long.
            let turn = (curvature * distance).clamp(-PI, PI);
            let chord = if turn == 0.0 {
                distance
            } else {
                distance * sin(0.5 * turn) / (0.5 * turn)
            };
            chord * direction(estimate.yaw + estimate.sideslip + 0.5 * turn)
        };
        let fence = &self.config.fence;
        [present, commanded].into_iter().all(|curvature| {
            let (half, whole) = (way(curvature, 0.5 * ahead), way(curvature, ahead));
            fence.contains_way(&estimate.position, &half)
                && fence.contains_way(&(estimate.position + half), &(whole - half))
        })
    }

    fn handle_board(&mut self, sample: &BoardSample) {
        self.supervisor.handle_board(sample.state);
        self.motor_speed = sample.motor_speed;
        self.board_time = Some(sample.time);
        self.steps.motor(sample.time, sample.motor_speed);
        if let Some(inertial) = &sample.inertial {
            self.imu_time = Some(inertial.time);
            let supervisor = &self.config.supervisor;
            let still = (supervisor.still_yaw_rate, supervisor.still_acceleration);
            self.imu.handle(inertial, &self.config.watch, still);
            let rests = self.imu.is_still()
                && sample.motor_speed == 0.0
                && !self.supervisor.mode().commands();
            self.steps.inertial(inertial, rests);
        }
        self.speeds.motor(sample.motor_speed);
        if let Some(inertial) = sample.inertial {
            self.estimator.handle_inertial(inertial, sample.motor_speed);
        }
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
