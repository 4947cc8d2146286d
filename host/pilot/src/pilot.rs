//! The whole controller as one value.

use core::f64::consts::PI;

use libm::{copysign, cos, fabs, sin};

use crate::{
    BoardRequest, BoardSample, Conditions, Event, Fence, Mode, Reason, Supervisor,
    SupervisorConfig, WatchConfig,
    watch::{BlindWatch, ImuWatch, SpeedWatch, TickWatch},
};
use singletrack_control::{
    Actuation, Estimate, Estimator, EstimatorConfig, FrontPointLaw, LimitedLaw, Limits, OuterLoop,
    PoseSample, PoseVerdict, Position, Reference, ReferencePoint, Time, TrackingLoop, Velocity,
    direction,
};

/// Everything that a [`Pilot`] is told once.
#[derive(Clone, Debug, PartialEq)]
pub struct PilotConfig {
    /// The law, with p and the believed `l_f`.
    pub law: FrontPointLaw,
    /// The position loop.
    pub tracking: TrackingLoop,
    /// Where P should be, from the first driving tick on.
    pub reference: Reference,
    /// What the car may do.
    pub limits: Limits,
    /// How the state is estimated.
    pub estimator: EstimatorConfig,
    /// When to stop.
    pub supervisor: SupervisorConfig,
    /// What the senses may say, and how punctual a tick must be.
    pub watch: WatchConfig,
    /// Where the car may be.
    pub fence: Fence,
    /// The deceleration that the car really has when it is told to stop, m/s²: a
    /// motor at neutral may brake less than `stop_deceleration` asks for.
    pub braking: f64,
    /// Deceleration of a stop, m/s².
    pub stop_deceleration: f64,
    /// The control period, s.
    pub period: f64,
}

/// What the board is to do until the next tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveCommand {
    /// Speed of the rear axle, m/s.
    pub rear_speed: f64,
    /// Steering angle, rad, left positive.
    pub steering: f64,
    /// Mid-exposure of the last accepted pose behind it.
    pub pose_time: Time,
}

/// What a tick saw and decided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// The mode after the tick.
    pub mode: Mode,
    /// Why the car does not drive, or stopped.
    pub reason: Option<Reason>,
    /// The state that it acted on.
    pub estimate: Option<Estimate>,
    /// Whether no new valid pose came since the tick before.
    pub held: bool,
    /// Time since the first driving tick, s; none when not driving.
    pub drive_time: Option<f64>,
    /// Where P should be and how fast it should move.
    pub reference: Option<ReferencePoint>,
    /// Where P is, as far as the law knows.
    pub point: Option<Position>,
    /// The velocity wanted of P, m/s.
    pub point_velocity: Option<Velocity>,
    /// Speed of G and steering after limits.
    pub actuation: Actuation,
    /// Whether the car is turning round.
    pub turning_round: bool,
    /// What to send to the board.
    pub command: Option<DriveCommand>,
    /// What to ask of the board.
    pub request: Option<BoardRequest>,
}

/// A drive is underway: nothing is reconfigured then.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the car drives (mode {0}): disarm it first")]
pub struct Underway(pub Mode);

/// From the decision to stop until the car begins to, s: a tick, the board, the
/// motor's lag.
const REACTION: f64 = 0.1;

/// Above this speed yaw rate and speed tell the bend, m/s.
const BENDS_FROM: f64 = 0.1;

/// Estimator, supervisor, outer loop, law and limits as one deterministic value.
///
/// It reads no clock and keeps no secret: the same configuration and the same
/// events at the same ticks give the same outputs, bit for bit.
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
    imu_time: Option<Time>,
    pose_time: Option<Time>,
    motor_speed: f64,
    drive_start: Option<Time>,
}

impl Pilot {
    /// A pilot that has seen nothing.
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
            imu_time: None,
            pose_time: None,
            motor_speed: 0.0,
            drive_start: None,
            config,
        }
    }

    /// Another configuration, from the next tick on. What is known of board and
    /// requests stays; the estimate begins anew.
    ///
    /// # Errors
    ///
    /// While a drive is underway. Nothing changes then.
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

    /// One control tick: takes in what happened since the last one and decides
    /// what the car does until the next.
    pub fn step<'a>(&mut self, now: Time, events: impl IntoIterator<Item = &'a Event>) -> Output {
        let mut held = true;
        for event in events {
            held &= !self.handle(event);
        }
        let steering = self.law.actuation().steering;
        let estimate = self.estimator.estimate(now, steering);
        if estimate.is_none() {
            self.pose_time = None;
        }
        let speed = estimate.map_or(0.0, |estimate| estimate.speed);
        // The fastest that anybody says it is.
        let pace = fabs(speed)
            .max(fabs(self.motor_speed))
            .max(fabs(self.law.actuation().speed));
        let (period, watch) = (self.config.period, &self.config.watch);
        self.blind.advance(now, pace);
        self.ticks.tick(now, period, watch);
        let max_speed = self.config.limits.max_speed;
        self.speeds.tick(speed, max_speed, watch);
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
        }
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
            request,
        };
        if let Some(estimate) = &estimate {
            let law = self.law.law();
            output.point = Some(law.point(estimate.position, estimate.yaw, steering));
            match mode {
                Mode::Driving => {
                    if let Err(reason) = self.drive(now, estimate, &mut output) {
                        request = Some(self.supervisor.fault(reason, now));
                        self.stand_by(mode);
                        output.mode = self.supervisor.mode();
                        output.reason = self.supervisor.reason();
                        output.command = None;
                        output.request = request;
                    }
                }
                Mode::Slowing | Mode::Stopping => {
                    let actuation = self.law.slow_down(self.config.stop_deceleration, period);
                    output.drive_time = self.drive_start.map(|start| now.seconds_since(start));
                    output.actuation = actuation;
                    output.command = Some(command(estimate, &actuation));
                }
                Mode::Disconnected | Mode::Idle | Mode::Ready | Mode::Arming | Mode::Fault => {}
            }
        }
        output
    }

    /// One tick of driving.
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
        let reference = self.config.reference.at(time);
        let velocity = self.config.tracking.velocity(&reference, &point);
        let actuation = self
            .law
            .step(
                &estimate.motion(),
                estimate.speed,
                &velocity,
                self.config.period,
            )
            .map_err(|_| Reason::LawSingular)?;
        // A blind car has no business speeding up.
        let actuation = if estimate.pose_age() > self.config.supervisor.fresh {
            self.law.cap_speed(fabs(before));
            self.law.actuation()
        } else {
            actuation
        };
        output.drive_time = Some(time);
        output.reference = Some(reference);
        output.point_velocity = Some(velocity);
        output.actuation = actuation;
        output.turning_round = self.law.is_turning_round();
        output.command = Some(command(estimate, &actuation));
        Ok(())
    }

    /// Takes in an event; true for a pose that was accepted.
    fn handle(&mut self, event: &Event) -> bool {
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
            Event::Setpoint(setpoint) => {
                if let Reference::External(external) = &mut self.config.reference {
                    external.handle(setpoint);
                }
            }
            // Whoever replays it has called `reconfigure`.
            Event::Reconfigured(_) => {}
        }
        false
    }

    fn handle_pose(&mut self, pose: &PoseSample) -> bool {
        let accepted = self.estimator.handle_pose(pose) == PoseVerdict::Accepted;
        if accepted {
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
        }
        accepted
    }

    /// Whether the car is inside the fence, and would be after a stop that begins
    /// now, from wherever it may have got to since it was last seen. It goes on
    /// along its bend: the wheels are held.
    fn stops_inside(&self, estimate: &Estimate, pace: f64) -> bool {
        let braking = 0.5 * pace * pace / self.config.braking;
        let ahead = self.blind.distance() + pace * REACTION + braking;
        let curvature = if fabs(estimate.speed) > BENDS_FROM {
            estimate.yaw_rate / estimate.speed
        } else {
            0.0
        };
        let way = |distance: f64| {
            let distance = copysign(distance, estimate.speed);
            // The chord of an arc that turns by this much.
            let turn = (curvature * distance).clamp(-PI, PI);
            let chord = if turn == 0.0 {
                distance
            } else {
                distance * sin(0.5 * turn) / (0.5 * turn)
            };
            chord * direction(estimate.yaw + estimate.sideslip + 0.5 * turn)
        };
        let (half, whole) = (way(0.5 * ahead), way(ahead));
        let fence = &self.config.fence;
        fence.contains_way(&estimate.position, &half)
            && fence.contains_way(&(estimate.position + half), &(whole - half))
    }

    fn handle_board(&mut self, sample: &BoardSample) {
        self.supervisor.handle_board(sample.state);
        self.motor_speed = sample.motor_speed;
        if let Some(inertial) = &sample.inertial {
            self.imu_time = Some(inertial.time);
            let supervisor = &self.config.supervisor;
            let still = (supervisor.still_yaw_rate, supervisor.still_acceleration);
            self.imu.handle(inertial, &self.config.watch, still);
        }
        self.speeds.motor(sample.motor_speed);
        if let Some(inertial) = sample.inertial {
            self.estimator.handle_inertial(inertial, sample.motor_speed);
        }
    }

    /// Forgets the drive; the reason stays told.
    fn stand_by(&mut self, was: Mode) {
        self.drive_start = None;
        self.law.reset();
        // A track that lost the car must find it anew: nothing is at stake
        // while the car stands.
        let lost = self.estimator.implausible_in_a_row() > 0;
        if lost && !was.commands() {
            self.estimator.reset();
        }
    }
}

/// The board drives the rear axle, whose speed is the forward part of G's.
fn command(estimate: &Estimate, actuation: &Actuation) -> DriveCommand {
    DriveCommand {
        rear_speed: actuation.speed * cos(estimate.sideslip),
        steering: actuation.steering,
        pose_time: estimate.pose_time,
    }
}
