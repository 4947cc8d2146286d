//! What a tick senses: the events and live tuning, and estimate and speeds. The car may also be one
//! that something else drives.

use libm::{copysign, fabs};
use singletrack_control::{
    Estimate, Estimator, External, InertialSample, PoseSample, PoseVerdict, Reference,
    SetpointError, Time,
};

use super::{Begins, Pilot, PilotConfig, SetpointRefusal};
use crate::{
    event::{Arming, BoardSample, Event, PilotRequest},
    supervisor::Reason,
    tuning::{POINT_DISTANCE_RATE, Tuned, Tuning},
    watch::Speeds,
};

impl Pilot {
    /// Handles an event; the verdict if it is a pose.
    pub(super) fn handle(&mut self, now: Time, event: &Event) -> Option<PoseVerdict> {
        self.supervisor.handle(event);
        match event {
            Event::Pose(pose) => return Some(self.handle_pose(pose)),
            Event::Neighbour(sample) => self.obstacles.handle(sample),
            Event::Board(sample) => self.handle_board(sample),
            Event::Request(request) => self.handle_request(*request),
            Event::Setpoint(setpoint) => {
                self.handle_setpoint(|external| external.handle(setpoint, now));
            }
            Event::TrajectoryPiece(piece) => {
                self.handle_setpoint(|external| external.handle_piece(piece, now));
            }
            Event::Jog(jog) => self.jog = Some(*jog),
            Event::Attitude(sample) => self.watches.attitude.handle(sample, &self.config.watch),
            Event::Proved(proved) => self.proved = *proved,
            Event::Tuning(tuning) => self.tune(tuning),
            Event::Begin(time) => self.begins = Begins::At(*time),
            Event::Learned(learned) => {
                if let Some(learning) = &mut self.learning {
                    learning.learned(now, *learned);
                }
            }
            // The caller has called `reconfigure` before this tick.
            Event::PoseMissing(_)
            | Event::Link(_)
            | Event::ArmRefused
            | Event::Health(_)
            | Event::Line(_)
            | Event::RealTime(_)
            | Event::Reconfigured(_) => {}
        }
        None
    }

    /// A lost car is taken up elsewhere by the operator's word alone: a program that ends disarms as
    /// well.
    fn handle_request(&mut self, request: PilotRequest) {
        match request {
            // One that comes in a drive is without effect: a car that waits goes on to wait.
            _ if self.supervisor.mode().is_underway() => {}
            PilotRequest::Arm(Arming::Waiting) => self.begins = Begins::Later,
            PilotRequest::Arm(_) => self.begins = Begins::AtOnce,
            _ => {}
        }
        if request == PilotRequest::Carried && !self.supervisor.mode().commands() {
            self.carried();
        }
    }

    /// Gives the reference a set-point. Without one that it does not refuse, it becomes stale.
    fn handle_setpoint(&mut self, give: impl FnOnce(&mut External) -> Result<(), SetpointError>) {
        let refused = match &mut self.config.reference {
            Reference::External(external) => give(external).err().map(SetpointRefusal::from),
            _ => Some(SetpointRefusal::NotExternal),
        };
        self.setpoint_refused = refused.or(self.setpoint_refused);
    }

    fn handle_pose(&mut self, pose: &PoseSample) -> PoseVerdict {
        // Before the estimator judges it: poses that are refused count too.
        self.watches.frozen.pose(pose, &self.config.watch);
        let verdict = self.estimator.handle_pose(pose);
        if verdict == PoseVerdict::Accepted {
            self.pose_time = Some(pose.capture);
            self.supervisor.handle_pose();
            let mode = self.supervisor.mode();
            self.watches
                .observe_accepted(pose, &self.estimator, mode, &self.config);
        }
        verdict
    }

    fn handle_board(&mut self, sample: &BoardSample) {
        self.supervisor.handle_board(sample.state);
        self.motor_speed = sample.motor_speed;
        // A board without its configuration does not know how far a pulse is: it says 0 whatever
        // the wheels do.
        let measures = self.supervisor.is_linked();
        self.motor_time = measures.then_some(sample.time);
        let mode = self.supervisor.mode();
        if let Some(inertial) = sample.inertial {
            self.imu_heard = Some(inertial.time);
        }
        let watches = &mut self.watches;
        let inertial = watches.observe_board(sample, self.imu, mode, &self.config);
        if let Some(inertial) = inertial {
            self.imu_time = Some(inertial.time);
            self.gyro = inertial.yaw_rate;
        }
        let nothing = InertialSample {
            time: sample.time,
            yaw_rate: f64::NAN,
            forward_acceleration: f64::NAN,
            left_acceleration: f64::NAN,
        };
        let motor_speed = measures.then_some(sample.motor_speed);
        match (inertial, self.imu) {
            (Some(inertial), Imu::Whole) => self.estimator.handle_inertial(inertial, motor_speed),
            (Some(inertial), _) => self.estimator.handle_partial(inertial, motor_speed),
            (None, Imu::Missing) => self.estimator.handle_partial(nothing, motor_speed),
            (None, _) => {}
        }
    }

    /// Takes over new values. Whoever sent them has checked them; values that the configuration
    /// in force does not allow have no effect, all together.
    fn tune(&mut self, tuning: &Tuning) {
        let bounds = self.config.tuning.as_ref();
        if !bounds.is_some_and(|bounds| bounds.allow(tuning)) {
            return;
        }
        if let Some(gain) = tuning.gain {
            self.tracking.set_gain(gain);
        }
        if let Some(distance) = tuning.point_distance {
            self.wanted_point_distance = distance;
        }
    }

    /// A tick begins: p goes on to where it was tuned.
    fn slew_point_distance(&mut self) {
        let (now, wanted) = (self.law.law().point_distance(), self.wanted_point_distance);
        if now == wanted {
            return;
        }
        let most = POINT_DISTANCE_RATE * self.config.period;
        let next = if fabs(wanted - now) <= most {
            wanted
        } else {
            now + copysign(most, wanted - now)
        };
        self.set_point_distance(next);
    }

    fn set_point_distance(&mut self, distance: f64) {
        // It is between two values that make a law.
        if let Ok(law) = self.law.law().with_point_distance(distance) {
            self.law.set_law(law);
        }
    }

    /// The values in force; none where nothing can be tuned.
    pub fn tuned(&self) -> Option<Tuned> {
        self.config.tuning.as_ref()?;
        Some(Tuned {
            gain: self.tracking.gain(),
            point_distance: self.law.law().point_distance(),
            wanted_point_distance: self.wanted_point_distance,
        })
    }

    /// The tuned values that another configuration leaves as they are.
    pub(super) fn kept_tuning(&self, next: &PilotConfig) -> Tuning {
        let (Some(old), Some(new)) = (&self.config.tuning, &next.tuning) else {
            return Tuning::default();
        };
        let same_gain = old.gain == new.gain && self.config.tracking.gain() == next.tracking.gain();
        let same_distance = old.point_distance == new.point_distance
            && self.config.law.point_distance() == next.law.point_distance();
        Tuning {
            gain: self.tracking.gain().filter(|_| same_gain),
            point_distance: same_distance.then_some(self.wanted_point_distance),
        }
    }

    /// Takes over what [`kept_tuning`](Self::kept_tuning) left; p is there at once, because the car
    /// stands.
    pub(super) fn keep_tuning(&mut self, kept: &Tuning) {
        self.tune(kept);
        self.set_point_distance(self.wanted_point_distance);
    }
}

/// The longest age of telemetry whose motor speed and inertial sample count, s.
const RECENT: f64 = 0.2;

/// Without the motor's speed, the longest age of a pose for which the speed is known, s: with inertial
/// samples, whose errors add up, and without them.
const SEEN: [f64; 2] = [1.0, 0.3];

/// What a tick senses.
pub(super) struct Sensed {
    pub(super) now: Time,
    pub(super) estimate: Option<Estimate>,
    /// Whether anything measures what the estimate says of the motion.
    pub(super) is_measured: bool,
    pub(super) speeds: Speeds,
    /// The largest of all speeds: estimated, measured and commanded, m/s.
    pub(super) pace: f64,
    /// Whether no pose was accepted.
    pub(super) held: bool,
    pub(super) last_tick: Option<Time>,
    /// Speed of the last command, m/s.
    pub(super) commanded_speed: f64,
}

impl Pilot {
    /// Handles the events in their order, and estimates the present. `foreign` is the steering (rad)
    /// and the speed (m/s) of the last command if that is not the law's; `judged` is told of each
    /// pose.
    pub(super) fn sense<'a>(
        &mut self,
        now: Time,
        events: impl IntoIterator<Item = &'a Event>,
        foreign: Option<(f64, f64)>,
        mut judged: impl FnMut(&Self, &Event, PoseVerdict),
    ) -> Sensed {
        let mut held = true;
        self.setpoint_refused = None;
        for event in events {
            if let Some(verdict) = self.handle(now, event) {
                held &= verdict != PoseVerdict::Accepted;
                judged(self, event, verdict);
            }
        }
        self.slew_point_distance();
        let last_tick = self.last_tick.replace(now);
        let sent = self.law.actuation();
        let commanded_speed = foreign.map_or(sent.speed, |(_, speed)| speed);
        if let Some((steering, _)) = foreign {
            self.estimator.send(now, steering);
        }
        let assumed = self.assumed.take();
        let own = self.estimator.estimate(now);
        let estimate = own.map(|own| assumed.unwrap_or(own));
        if estimate.is_none() {
            self.pose_time = None;
        }
        let speed = estimate.map_or(0.0, |estimate| estimate.speed);
        if let Some(compensator) = &mut self.compensator {
            compensator.predictor.advance(now, speed);
        }
        let pace = fabs(speed)
            .max(fabs(self.motor_speed))
            .max(fabs(commanded_speed));
        let (steering, config) = (self.commanded_steering, &self.config);
        self.watches
            .observe_tick(now, estimate.as_ref(), pace, steering, config);
        let braking = self.watches.braking(config);
        let (wave, period) = (self.wave(), config.period);
        self.safety.observe(pace, steering, braking, period);
        let witnessed = estimate.map(|it| self.witnessed(now, &it));
        self.safety.watch(witnessed.as_ref(), wave, period);
        let drives = self.supervisor.mode().is_underway();
        self.obstacles.observe(now, estimate.as_ref(), drives);
        let within = |time: Option<Time>, longest: f64| {
            time.is_some_and(|time| now.seconds_since(time) <= longest)
        };
        let heard = within(self.motor_time, RECENT);
        let [reckoned, alone] = SEEN;
        let reckons = within(self.imu_time, RECENT);
        let seen = within(self.pose_time, if reckons { reckoned } else { alone });
        let is_measured = heard || seen;
        Sensed {
            now,
            estimate,
            is_measured,
            speeds: Speeds {
                motor: heard.then_some(self.motor_speed),
                cameras: self.watches.steps.camera_speed(now),
                estimate: estimate
                    .filter(|_| is_measured)
                    .map(|estimate| estimate.speed),
            },
            pace,
            held,
            last_tick,
            commanded_speed,
        }
    }

    /// The estimate with the yaw rate of the gyro alone, less its bias: what the steering says of the
    /// yaw rate is in the estimate, which is no witness against it.
    pub(super) fn witnessed(&self, now: Time, estimate: &Estimate) -> Estimate {
        let is_recent = self
            .imu_time
            .is_some_and(|time| now.seconds_since(time) <= RECENT);
        if !is_recent {
            return *estimate;
        }
        let estimator = &self.estimator;
        Estimate {
            yaw_rate: (self.gyro - estimator.gyro_bias()) / estimator.gyro_scale(),
            ..*estimate
        }
    }
}

/// What something else commands a car.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Commanded {
    /// Steering angle, rad; positive to the left.
    pub steering: f64,
    /// Speed of the rear axle, m/s; none if it is not known.
    pub speed: Option<f64>,
    /// Whether the car is driven. Where that begins, a drive begins.
    pub drives: bool,
    /// What the car has of an IMU.
    pub imu: Imu,
}

/// What a car that something else drives has of an IMU. A car of ours has all of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Imu {
    /// Gyro and accelerometer.
    #[default]
    Whole,
    /// A gyro alone: the accelerations of its samples are NaN.
    Gyro,
    /// Neither: the board's samples have the motor's speed alone.
    Missing,
}

/// What the pilot has seen of a car in a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observed {
    /// The estimated state.
    pub estimate: Option<Estimate>,
    /// What would end the drive; none if nothing would, or the car is not driven.
    pub stop: Option<Reason>,
}

impl Pilot {
    /// A tick of a car that something else drives, in place of [`Pilot::step`]: handles the events,
    /// and says what would end a drive. Nothing is commanded. `judged` is told of each pose, of
    /// the estimator's verdict, and of its normalised innovation squared before any weighting.
    ///
    /// What has no input is not judged: the board's status without one, and whatever belongs to
    /// commands that were not given, such as arming, the proving run and the stop.
    pub fn observe<'a>(
        &mut self,
        now: Time,
        events: impl IntoIterator<Item = &'a Event>,
        commanded: &Commanded,
        mut judged: impl FnMut(&PoseSample, PoseVerdict, f64),
    ) -> Observed {
        self.commanded_steering = commanded.steering;
        self.imu = commanded.imu;
        let foreign = (commanded.steering, commanded.speed.unwrap_or(0.0));
        let sensed = self.sense(now, events, Some(foreign), |pilot, event, verdict| {
            if let Event::Pose(pose) = event {
                judged(pose, verdict, pilot.estimator.innovation());
            }
        });
        if self.supervisor.observe(commanded.drives, now) {
            self.watches.begin(false);
            // A drive of ours is armed only where they are not too rare.
            self.watches.steps.begin(now);
            // Not so a drive of ours, which begins with a car at rest, and has an accelerometer.
            let moves = self.motor_speed.abs() >= self.config.supervisor.standing_speed;
            if moves || self.imu != Imu::Whole {
                self.watches.drive.start.is_judged = true;
            }
        }
        let conditions = self.conditions(&sensed);
        Observed {
            estimate: sensed.estimate,
            stop: self.supervisor.observed(&conditions),
        }
    }

    /// A person says that the body which the cameras show is the car: see
    /// [`PilotRequest::Carried`].
    pub fn carried(&mut self) {
        if self.estimator.implausible_in_a_row > 0 {
            self.estimator.reset();
        }
    }

    /// Lets the next tick take this for its estimate, if it has one of its own: for studies in virtual
    /// time of what the estimate costs. No daemon calls it, and no record can be replayed that has it.
    pub const fn assume(&mut self, estimate: Estimate) {
        self.assumed = Some(estimate);
    }

    /// The estimator.
    pub const fn estimator(&self) -> &Estimator {
        &self.estimator
    }
}
