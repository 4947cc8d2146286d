//! What a tick judges: whether the car may drive, and what is asked of the board.

use libm::{copysign, fabs, tan};
use singletrack_control::{Estimate, Reference, Stop, Time, Velocity, along_bend, direction};

use super::{Begins, Imu, Pilot, sense::Sensed};
use crate::{
    supervisor::{BoardRequest, Conditions, Mode, Reason},
    watch::{ImuVerdict, StopLimits},
};

/// The time from the decision to stop until the car decelerates, s: a tick, the board
/// and the lag of the motor.
const REACTION: f64 = 0.1;

/// The lowest speed at which yaw rate over speed gives the curvature, m/s.
const BENDS_FROM: f64 = 0.1;

/// What a tick judges, besides the supervisor's mode and reasons.
pub(super) struct Verdict {
    /// What to ask of the board.
    pub(super) request: Option<BoardRequest>,
    /// The deceleration of a stop that has ended, m/s².
    pub(super) braking_measured: Option<f64>,
}

/// A car that waited begins with its time if no more ticks were left out, else with the tick: P must
/// not jump.
const MISSED_TICKS: f64 = 5.0;

impl Pilot {
    /// Takes the supervisor to its next mode; begins and ends a drive.
    pub(super) fn judge(&mut self, sensed: &Sensed) -> Verdict {
        let (now, speeds) = (sensed.now, &sensed.speeds);
        let was = self.supervisor.mode();
        let request = self.supervisor.step(&self.conditions(sensed));
        let mode = self.supervisor.mode();
        let waits = self.begins == Begins::Later;
        if mode == Mode::Driving && (was == Mode::Arming || (self.drive_start.is_none() && !waits))
        {
            // A car that waits begins once more, from where it stands then.
            self.begin_drive(sensed);
            self.drive_start = match self.begins {
                Begins::AtOnce => Some(now),
                Begins::Later => None,
                Begins::At(time) => {
                    let missed = 0.0..=MISSED_TICKS * self.config.period;
                    let is_now = missed.contains(&now.seconds_since(time));
                    Some(if is_now { time } else { now })
                }
            };
        }
        if mode != Mode::Jogging || was != Mode::Jogging {
            // Pulses from before the board was armed do not count.
            self.jog = None;
        }
        let follows = |mode| matches!(mode, Mode::Driving | Mode::Slowing);
        if follows(mode) || mode == Mode::Jogging {
            self.watches.stops.end();
        } else if was == Mode::Jogging {
            self.watches.stops.begin_after_jogging(now, speeds);
        } else if follows(was) {
            let commanded = if mode == Mode::Stopping {
                self.law.actuation().speed
            } else {
                0.0
            };
            self.watches.begin_stop(now, speeds, commanded);
            if self.supervisor.reason().is_some_and(Reason::doubts_cameras) {
                self.watches.stops.doubt_cameras();
            }
        }
        if !mode.commands() {
            self.watches.proving = None;
        }
        let limits = StopLimits {
            braking: self.config.braking,
            ramp: self.config.stop_deceleration,
            standing: self.config.supervisor.standing_speed,
        };
        let stop = self.watches.stops.tick(now, speeds, &limits);
        let emergency = stop.disobeyed.then(|| self.supervisor.stop_not_obeyed(now));
        let mode = self.supervisor.mode();
        if matches!(mode, Mode::Idle | Mode::Disconnected | Mode::Fault) {
            self.stand_by();
        }
        Verdict {
            request: emergency.or(request),
            braking_measured: stop.measured,
        }
    }

    /// The law has no command: the drive ends at neutral.
    pub(super) fn fault(&mut self, reason: Reason, sensed: &Sensed) -> BoardRequest {
        let request = self.supervisor.fault(reason, sensed.now);
        self.watches.begin_stop(sensed.now, &sensed.speeds, 0.0);
        self.watches.proving = None;
        self.stand_by();
        request
    }

    /// Ends the drive: clears its start and the state of the law, and keeps the reason.
    fn stand_by(&mut self) {
        self.drive_start = None;
        self.law.reset();
    }

    /// What the supervisor judges by.
    pub(super) fn conditions(&self, sensed: &Sensed) -> Conditions {
        let (now, config, watches) = (sensed.now, &self.config, &self.watches);
        let path_time = self
            .drive_start
            .map(|start| now.seconds_since(start) - self.waited);
        let (estimate, speeds) = (sensed.estimate.as_ref(), &sensed.speeds);
        let implausible_motion = watches
            .implausible_motion(&self.estimator, &config.watch)
            .or(self
                .safety
                .bends_otherwise()
                .then_some(Reason::SteeringDiffers));
        Conditions {
            now,
            pose_time: self.pose_time,
            blind_distance: watches.blind.distance,
            poses: self.estimator.poses(),
            implausible: self.estimator.implausible_in_a_row,
            imu_time: match self.imu {
                Imu::Missing => Some(now),
                Imu::Whole | Imu::Gyro => self.imu_heard,
            },
            imu: match watches
                .imu
                .verdict(self.estimator.gyro_bias(), &config.watch)
            {
                // A gyro alone that is rounded repeats while the car stands.
                ImuVerdict::Stuck if self.imu == Imu::Gyro => ImuVerdict::Good,
                verdict => verdict,
            },
            imu_still: watches.imu.is_still(),
            speed: estimate.map_or(0.0, |estimate| estimate.speed),
            motor_speed: self.motor_speed,
            camera_speed: speeds.cameras,
            stands: speeds
                .worst()
                .is_some_and(|speed| speed < config.supervisor.standing_speed),
            preflight: watches.preflight(config),
            doubt: watches.doubt(now),
            implausible_motion,
            contradiction: watches.contradiction(implausible_motion),
            speed_mismatch: watches.drive.speeds.is_mismatched(),
            overspeed: watches.drive.speeds.is_overspeed(),
            commanded_speed: sensed.commanded_speed,
            filter: self.safety.ends,
            inside_fence: estimate.is_none_or(|it| self.stops_inside(now, it, sensed.pace)),
            neighbours: self.neighbours_in_the_way(sensed),
            late: watches.ticks.is_late(&config.watch),
            setpoint_stale: match &config.reference {
                Reference::External(external) => external.is_stale(now),
                _ => false,
            },
            reference_finished: match (path_time, config.reference.duration()) {
                (Some(time), Some(duration)) => {
                    let governor = self.governor.as_ref();
                    governor.map_or(time, |governor| governor.path_at(time)) >= duration
                }
                _ => false,
            },
        }
    }

    /// Whether the car is inside the geofence, and stays inside if it stops now.
    ///
    /// The path ahead is the distance since the last pose and the way of a stop from the speed
    /// `pace` (m/s). A stop holds the steering, so the
    /// path follows the commanded curvature; and the present one, from which the wheels turn
    /// there.
    fn stops_inside(&self, now: Time, estimate: &Estimate, pace: f64) -> bool {
        let fence = &self.config.fence;
        self.stops(now, estimate, pace)
            .iter()
            .all(|places| fence.contains_path(&estimate.position, places))
    }

    /// Which reason of other bodies forbids to drive: a car that stands can't do better.
    fn neighbours_in_the_way(&self, sensed: &Sensed) -> Option<Reason> {
        if self.obstacles.are_unknown() {
            return Some(Reason::NeighbourUnknown);
        }
        let (estimate, sides) = (sensed.estimate.as_ref()?, &self.obstacles.last_sides);
        let moves = sensed.pace >= self.config.supervisor.standing_speed;
        if sides.is_empty() || !moves {
            return None;
        }
        let stops = self.stops(sensed.now, estimate, sensed.pace);
        let clear = stops.iter().flatten().all(|way| {
            let place = estimate.position + way;
            // A NaN is not.
            sides.iter().all(|side| side.distance(&place) >= 0.0)
        });
        (!clear).then_some(Reason::NeighbourNear)
    }

    /// The ways of a stop, half and whole, that the car may take from the estimate (m): the bend of
    /// the present path, and that of the commanded steering.
    fn stops(&self, now: Time, estimate: &Estimate, pace: f64) -> [[Velocity; 2]; 2] {
        let stop = Stop {
            reaction: REACTION,
            braking: self.watches.braking(&self.config),
        };
        let ahead = self.watches.blind.distance + stop.way(pace);
        let present = if fabs(estimate.speed) > BENDS_FROM {
            self.witnessed(now, estimate).yaw_rate / estimate.speed
        } else {
            0.0
        };
        let commanded = tan(self.commanded_steering) / self.config.estimator.wheelbase;
        let course = direction(estimate.yaw + estimate.sideslip);
        [present, commanded]
            .map(|curvature| along_bend(&course, curvature, copysign(ahead, estimate.speed)))
    }
}
