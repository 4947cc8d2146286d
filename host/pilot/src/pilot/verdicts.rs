//! What the watches say about arming and driving, and whether the car stays inside the geofence.

use core::f64::consts::PI;

use libm::{copysign, fabs, sin, tan};
use singletrack_control::{Estimate, Time, direction};

use super::Pilot;
use crate::{
    supervisor::Reason,
    watch::{Speeds, StopLimits},
};

/// The time from the decision to stop until the car decelerates, s: a tick, the board
/// and the lag of the motor.
const REACTION: f64 = 0.1;

/// The deceleration assumed of an unproved car, m/s²: that of one that rolls well.
const UNPROVED_BRAKING: f64 = 0.25;

/// The longest age of telemetry whose motor speed counts, s.
const MOTOR_RECENT: f64 = 0.2;

/// The lowest speed at which yaw rate over speed gives the curvature, m/s.
const BENDS_FROM: f64 = 0.1;

impl Pilot {
    /// What forbids to arm, by the watches.
    pub(super) fn preflight(&self) -> Option<Reason> {
        let marker_yaw = self.config.estimator.marker_yaw;
        self.attitude
            .check(marker_yaw, &self.config.watch)
            .or(match () {
                () if self.push.is_wrong() => Some(Reason::BodyYawWrong),
                // What it measures decides about the next drive.
                () if self.stops.is_underway() => Some(Reason::Moving),
                () if self.stops.is_too_weak(self.config.braking) => {
                    Some(Reason::BrakesLessThanConfigured)
                }
                () => None,
            })
    }

    /// What forbids to arm and to drive, by the watches.
    pub(super) fn doubt(&self, now: Time) -> Option<Reason> {
        if self.frozen.is_frozen() {
            Some(Reason::PoseFrozen)
        } else if self.steps.are_too_rare(now) {
            Some(Reason::PosesTooRare)
        } else if self.attitude.is_uncertain() {
            Some(Reason::CaptureTimeUncertain)
        } else {
            None
        }
    }

    /// What ends a drive, by the watches.
    pub(super) fn implausible_motion(&self) -> Option<Reason> {
        let watch = &self.config.watch;
        let [forward, left] = self.estimator.acceleration_bias();
        // What gyro and cameras agree on is the turn of the car.
        if self.gyro.is_opposite() {
            Some(Reason::GyroDiffers)
        } else if self.sideslip.is_exceeded() || self.slide.is_exceeded() {
            Some(match &self.proving {
                Some(proving) if proving.moves_across() => Reason::BodyYawWrong,
                _ => Reason::SideslipImplausible,
            })
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
    pub(super) fn contradiction(&self) -> Option<Reason> {
        let proving = self.proving.as_ref()?;
        let mismatch = self.speeds.is_mismatched();
        proving
            .found()
            .or_else(|| self.implausible_motion())
            .or(mismatch.then_some(Reason::MotorSpeedMismatch))
    }

    pub(super) fn speeds_at(&self, now: Time, estimate: Option<&Estimate>) -> Speeds {
        let heard = self
            .board_time
            .is_some_and(|time| now.seconds_since(time) <= MOTOR_RECENT);
        Speeds {
            motor: heard.then_some(self.motor_speed),
            cameras: self.steps.camera_speed(now),
            estimate: estimate.map(|estimate| estimate.speed),
        }
    }

    pub(super) const fn stop_limits(&self) -> StopLimits {
        StopLimits {
            braking: self.config.braking,
            ramp: self.config.stop_deceleration,
            standing: self.config.supervisor.standing_speed,
        }
    }

    /// The deceleration that the geofence relies on, m/s²: as configured or as measured,
    /// whichever is lower.
    pub(super) fn braking(&self) -> f64 {
        let known = self.stops.relied_on(self.config.braking);
        if self.proving.is_some() {
            known.min(UNPROVED_BRAKING)
        } else {
            known
        }
    }

    /// Whether the car is inside the geofence, and stays inside if it stops now.
    ///
    /// The path ahead is the distance since the last pose, the reaction distance and the
    /// braking distance v²/2a, at the speed `pace` (m/s). A stop holds the steering, so the
    /// path follows the commanded curvature; and the present one, from which the wheels turn
    /// there.
    pub(super) fn stops_inside(&self, estimate: &Estimate, pace: f64) -> bool {
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
            fence.contains_ways(&estimate.position, &[half, whole - half])
        })
    }
}
