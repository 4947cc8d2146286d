//! The whole controller as one value: events of a tick in, one command out.

mod compensation;
mod drive;
mod events;
mod interface;
mod observe;
mod safety;
mod sense;
mod tune;
mod verdicts;

use libm::rint;
use singletrack_control::{
    Estimate, Estimator, Governor, LimitedLaw, OuterLoop, Reference, Time, TrackingLoop, Velocity,
};

use crate::{
    event::{Event, Jog},
    refusal::SetpointRefusal,
    supervisor::{Mode, Reason, Supervisor},
    watch::{
        AttitudeWatch, BlindWatch, FrozenWatch, GyroWatch, ImuWatch, InnovationWatch,
        PROVING_SPEED, Proving, PushWatch, SideslipWatch, SlideWatch, SpeedWatch, StartWatch,
        SteeringWatch, Steps, StopWatch, TickWatch,
    },
};

use compensation::Compensator;
use drive::command;
use safety::Safety;
use sense::Sensed;

pub use compensation::Compensation;
pub use interface::{DriveCommand, Output, PilotConfig, Underway};
pub use observe::{Commanded, Observed};
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
    /// None if the reference is followed as it is.
    governor: Option<Governor>,
    /// None if the actuators are not compensated.
    compensator: Option<Compensator>,
    safety: Safety,
    /// Where p goes to, in m; the law has the one of now.
    wanted_point_distance: f64,
    estimator: Estimator,
    supervisor: Supervisor,
    imu: ImuWatch,
    speeds: SpeedWatch,
    ticks: TickWatch,
    blind: BlindWatch,
    stops: StopWatch,
    steps: Steps,
    sideslip: SideslipWatch,
    slide: SlideWatch,
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
            governor: config.governor(),
            compensator: Compensator::of(&config.compensation),
            safety: Safety::new(config.safety.as_ref()),
            wanted_point_distance: config.law.point_distance(),
            estimator: Estimator::new(config.estimator),
            supervisor: Supervisor::new(config.supervisor),
            imu: ImuWatch::default(),
            speeds: SpeedWatch::default(),
            ticks: TickWatch::default(),
            blind: BlindWatch::default(),
            stops: StopWatch::default(),
            steps: Steps::default(),
            sideslip: SideslipWatch::default(),
            slide: SlideWatch::default(),
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
        self.tracking.clone_from(&config.tracking);
        self.wanted_point_distance = config.law.point_distance();
        self.keep_tuning(&kept);
        self.governor = config.governor();
        self.compensator = Compensator::of(&config.compensation);
        self.safety = Safety::new(config.safety.as_ref());
        self.estimator.reconfigure(config.estimator);
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
        let sensed = self.sense(now, events, None, |_, _, _| {});
        let Sensed {
            estimate,
            speeds,
            held,
            last_tick,
            ..
        } = sensed;
        let period = self.config.period;
        let was = self.supervisor.mode();
        let mut request = self.supervisor.step(&self.conditions(now, &sensed));
        let mode = self.supervisor.mode();
        if mode == Mode::Driving && was == Mode::Arming {
            self.drive_start = Some(now);
            self.law.reset();
            self.tracking.reset();
            self.applied = Velocity::zeros();
            if let Some(governor) = &mut self.governor {
                governor.reset();
            }
            if let Some(compensator) = &mut self.compensator {
                compensator.begin(self.law.actuation().steering);
            }
            self.safety.begin(self.commanded_steering);
            self.begin_watches();
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
            let share = self.speeds.motor_share();
            self.stops.begin(now, &speeds, commanded, share);
            if self.supervisor.reason().is_some_and(Reason::doubts_cameras) {
                self.stops.doubt_cameras();
            }
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
            self.stand_by();
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
            path: None,
            slowed_by: None,
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
            tuned: self.tuned(),
        };
        if let Some(estimate) = &estimate {
            let law = self.law.law();
            let wheels = self.wheels();
            output.point = Some(law.point(estimate.position, estimate.yaw, wheels));
            // A sideslip that the car can't have is not acted on.
            let believed = Estimate {
                sideslip: if self.slide.is_beyond() {
                    0.0
                } else {
                    estimate.sideslip
                },
                ..*estimate
            };
            let estimate = &believed;
            match mode {
                Mode::Driving => {
                    if let Err(reason) = self.drive(now, estimate, &mut output) {
                        request = Some(self.supervisor.fault(reason, now));
                        let share = self.speeds.motor_share();
                        self.stops.begin(now, &speeds, 0.0, share);
                        self.proving = None;
                        self.stand_by();
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

    /// A drive begins: what its watches saw of the last one is forgotten.
    fn begin_watches(&mut self) {
        self.speeds.reset();
        self.sideslip.reset();
        self.slide = SlideWatch::default();
        self.steering.reset();
        self.gyro.reset();
        self.start.reset();
        self.innovations.reset();
    }

    /// Ends the drive: clears its start and the state of the law, and keeps the reason.
    fn stand_by(&mut self) {
        self.drive_start = None;
        self.law.reset();
    }
}
