//! The watches of a pilot: what they observe, and what they find.

use libm::fabs;
use singletrack_control::{Estimate, Estimator, InertialSample, PoseSample, Time};

use super::{Imu, PilotConfig};
use crate::{
    event::BoardSample,
    supervisor::{Mode, Reason},
    watch::{
        AttitudeWatch, BlindWatch, FIRST_METRE, FrozenWatch, GyroWatch, ImuWatch, InnovationWatch,
        Proving, PushWatch, SideslipWatch, SlideWatch, SpeedWatch, Speeds, StartWatch,
        SteeringWatch, Steps, StopWatch, TickWatch, WatchConfig,
    },
};

/// All watches.
#[derive(Clone, Debug, Default)]
pub(super) struct Watches {
    pub(super) imu: ImuWatch,
    pub(super) ticks: TickWatch,
    pub(super) blind: BlindWatch,
    pub(super) stops: StopWatch,
    pub(super) steps: Steps,
    pub(super) attitude: AttitudeWatch,
    pub(super) drive: DriveWatches,
    /// The comparison of the sensors; only in a drive of an unproved configuration.
    pub(super) proving: Option<Proving>,
    pub(super) frozen: FrozenWatch,
    push: PushWatch,
}

/// What is watched of one drive.
#[derive(Clone, Debug, Default)]
pub(super) struct DriveWatches {
    pub(super) speeds: SpeedWatch,
    pub(super) slide: SlideWatch,
    pub(super) start: StartWatch,
    sideslip: SideslipWatch,
    steering: SteeringWatch,
    gyro: GyroWatch,
    innovations: InnovationWatch,
}

impl Watches {
    /// A drive begins, in which the sensors are compared or not.
    pub(super) fn begin(&mut self, proves: bool) {
        self.drive = DriveWatches::default();
        self.proving = proves.then(Proving::default);
    }

    /// The estimate restarts.
    pub(super) fn reset(&mut self) {
        self.drive.speeds = SpeedWatch::default();
        self.steps.reset();
    }

    /// The pose that the estimator has accepted, in this mode.
    pub(super) fn observe_accepted(
        &mut self,
        pose: &PoseSample,
        estimator: &Estimator,
        mode: Mode,
        config: &PilotConfig,
    ) {
        let (watch, car) = (&config.watch, &config.estimator);
        let drive = &mut self.drive;
        drive.innovations.pose(estimator.innovation(), watch);
        self.blind.seen(pose.capture);
        let centre = estimator.centre_of_mass(pose);
        let (time, position, yaw) = (pose.capture, centre.position, centre.yaw);
        drive.speeds.pose(time, position, yaw, watch);
        let Some(step) = self.steps.pose(time, position, yaw, car.rear_axle_distance) else {
            return;
        };
        match mode {
            Mode::Driving | Mode::Slowing => {
                let pace = step.rear.norm() / step.time;
                let variance = car.acceleration_variance(pace * pace);
                drive.start.step(&step, variance);
                drive.gyro.step(&step);
                drive.sideslip.step(&step, watch);
                drive.steering.step(&step, car.wheelbase, watch);
                if let Some(proving) = &mut self.proving {
                    proving.step(&step, car.wheelbase, watch.pulse_distance);
                }
            }
            Mode::Jogging => {}
            _ => self.push.step(&step),
        }
    }

    /// A record of the board, in this mode. Returns its inertial sample if that is possible; no
    /// other one may be used.
    pub(super) fn observe_board(
        &mut self,
        sample: &BoardSample,
        imu: Imu,
        mode: Mode,
        config: &PilotConfig,
    ) -> Option<InertialSample> {
        self.steps.motor(sample.time, sample.motor_speed);
        self.drive.speeds.motor(sample.motor_speed);
        let inertial = sample.inertial?;
        let supervisor = &config.supervisor;
        let still = (supervisor.still_yaw_rate, supervisor.still_acceleration);
        let watched = match imu {
            Imu::Gyro => InertialSample {
                forward_acceleration: 0.0,
                left_acceleration: 0.0,
                ..inertial
            },
            Imu::Whole | Imu::Missing => inertial,
        };
        self.imu.handle(&watched, &config.watch, still);
        if !config.watch.is_possible(&watched) {
            return None;
        }
        let rests = self.imu.is_still() && sample.motor_speed == 0.0 && !mode.commands();
        self.steps.inertial(&watched, rests);
        Some(inertial)
    }

    /// A tick, with the largest of all speeds (m/s), and the steering of the last command (rad).
    pub(super) fn observe_tick(
        &mut self,
        now: Time,
        estimate: Option<&Estimate>,
        pace: f64,
        steering: f64,
        config: &PilotConfig,
    ) {
        self.steps.tick(now, steering);
        self.attitude.tick(now);
        self.blind.advance(now, pace);
        self.ticks.tick(now, config.period, &config.watch);
        let speed = estimate.map_or(0.0, |estimate| estimate.speed);
        let most = config.limits.max_speed.min(self.speed_cap());
        self.drive.speeds.tick(speed, most, &config.watch);
        self.drive
            .slide
            .tick(estimate, &config.estimator, &config.limits);
    }

    /// A drive ends, with this speed commanded from here on (m/s).
    pub(super) fn begin_stop(&mut self, now: Time, speeds: &Speeds, commanded: f64) {
        let share = self.drive.speeds.motor_share();
        self.stops.begin(now, speeds, commanded, share);
    }

    /// What forbids to arm.
    pub(super) fn preflight(&self, config: &PilotConfig) -> Option<Reason> {
        let marker_yaw = config.estimator.marker_yaw;
        self.attitude.check(marker_yaw, &config.watch).or(match () {
            () if self.push.is_wrong => Some(Reason::BodyYawWrong),
            // What it measures decides about the next drive.
            () if self.stops.is_underway() => Some(Reason::Moving),
            () if self.stops.is_too_weak(config.braking) => Some(Reason::BrakesLessThanConfigured),
            () => None,
        })
    }

    /// What forbids to arm and to drive.
    pub(super) fn doubt(&self, now: Time) -> Option<Reason> {
        match () {
            () if self.frozen.is_frozen => Some(Reason::PoseFrozen),
            () if self.steps.are_too_rare(now) => Some(Reason::PosesTooRare),
            () if self.attitude.is_uncertain() => Some(Reason::CaptureTimeUncertain),
            () => None,
        }
    }

    /// Whether anything is on the way to end a drive, or the first metre is driven.
    pub(super) fn doubts_motion(&self, now: Time) -> bool {
        self.proving.is_some()
            || self.drive.slide.is_beyond
            || self.drive.steering.is_doubtful()
            || self.doubt(now).is_some()
    }

    /// What ends a drive.
    pub(super) fn implausible_motion(
        &self,
        estimator: &Estimator,
        watch: &WatchConfig,
    ) -> Option<Reason> {
        let drive = &self.drive;
        let [forward, left] = estimator.acceleration_bias();
        let bias = fabs(forward).max(fabs(left));
        // What gyro and cameras agree on is the turn of the car.
        match () {
            () if drive.gyro.is_opposite => Some(Reason::GyroDiffers),
            () if drive.sideslip.is_exceeded() || drive.slide.is_exceeded() => {
                Some(self.across().unwrap_or(Reason::SideslipImplausible))
            }
            () if drive.steering.is_exceeded() => Some(Reason::SteeringDiffers),
            () if drive.start.differs || bias > watch.max_acceleration_bias => {
                Some(Reason::AccelerometerDiffers)
            }
            () if drive.innovations.is_inconsistent() => Some(Reason::EstimateInconsistent),
            () => None,
        }
    }

    /// What contradicts in the drive of an unproved configuration: what the comparison finds,
    /// and whatever the watches of every drive find before it.
    pub(super) fn contradiction(&self, implausible_motion: Option<Reason>) -> Option<Reason> {
        let mismatch = self.drive.speeds.is_mismatched();
        self.proving
            .as_ref()?
            .found
            .or(implausible_motion)
            .or(mismatch.then_some(Reason::MotorSpeedMismatch))
    }

    /// An unproved car that moves across its yaw rather than along it.
    pub(super) fn across(&self) -> Option<Reason> {
        self.proving
            .as_ref()
            .is_some_and(Proving::moves_across)
            .then_some(Reason::BodyYawWrong)
    }

    /// The most that the first metre leaves of a speed, m/s.
    pub(super) const fn speed_cap(&self) -> f64 {
        if self.proving.is_some() {
            FIRST_METRE.speed
        } else {
            f64::INFINITY
        }
    }

    /// The deceleration that the geofence relies on, m/s²: as configured or as measured,
    /// whichever is lower.
    pub(super) fn braking(&self, config: &PilotConfig) -> f64 {
        let known = self.stops.relied_on(config.braking);
        if self.proving.is_some() {
            known.min(FIRST_METRE.braking)
        } else {
            known
        }
    }
}
