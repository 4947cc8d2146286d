//! The whole controller as one value: events of a tick in, one command out.

mod events;
mod interface;
mod verdicts;

use libm::{cos, fabs, rint};
use singletrack_control::{
    Actuation, Demand, Estimate, Estimator, LimitedLaw, OuterLoop, Reference, Time,
};

use crate::{
    event::{Event, Jog},
    supervisor::{Conditions, Mode, Reason, Supervisor},
    watch::{
        AttitudeWatch, BlindWatch, FrozenWatch, ImuWatch, InnovationWatch, PROVING_SPEED, Proving,
        PushWatch, SideslipWatch, SpeedWatch, StartWatch, SteeringWatch, Steps, StopWatch,
        TickWatch,
    },
};

pub use interface::{DriveCommand, Output, PilotConfig, Underway};

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

    /// A tick in [`Mode::Driving`]: reference, position loop and law, or the actuation that a
    /// controller outside demands. Fails where the law is singular.
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
