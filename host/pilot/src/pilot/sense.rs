//! What a tick senses: events to estimate and speeds, and the conditions that they make.

use libm::fabs;
use singletrack_control::{Estimate, PoseVerdict, Reference, Time};

use super::Pilot;
use crate::{
    event::Event,
    supervisor::Conditions,
    watch::{PROVING_SPEED, Speeds},
};

/// What a tick senses.
pub(super) struct Sensed {
    pub(super) estimate: Option<Estimate>,
    pub(super) speeds: Speeds,
    /// The largest of all speeds: estimated, measured and commanded, m/s.
    pub(super) pace: f64,
    /// Whether no pose was accepted.
    pub(super) held: bool,
    pub(super) last_tick: Option<Time>,
    /// Speed of the last command, m/s.
    commanded_speed: f64,
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
        let (steering, commanded_speed) = foreign.unwrap_or((sent.steering, sent.speed));
        let estimate = self.estimator.estimate(now, steering);
        if estimate.is_none() {
            self.pose_time = None;
        }
        let speed = estimate.map_or(0.0, |estimate| estimate.speed);
        if let Some(compensator) = &mut self.compensator {
            compensator.advance(now, speed);
        }
        let pace = fabs(speed)
            .max(fabs(self.motor_speed))
            .max(fabs(commanded_speed));
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
        let (car, limits) = (&self.config.estimator, &self.config.limits);
        self.slide.tick(estimate.as_ref(), car, limits);
        Sensed {
            estimate,
            speeds,
            pace,
            held,
            last_tick,
            commanded_speed,
        }
    }

    /// What the supervisor judges by.
    pub(super) fn conditions(&self, now: Time, sensed: &Sensed) -> Conditions {
        let watch = &self.config.watch;
        let drive_time = self.drive_start.map(|start| now.seconds_since(start));
        let (estimate, speeds) = (sensed.estimate.as_ref(), &sensed.speeds);
        Conditions {
            now,
            pose_time: self.pose_time,
            blind_distance: self.blind.distance(),
            poses: self.estimator.poses(),
            implausible: self.estimator.implausible_in_a_row(),
            imu_time: self.imu_time,
            imu: self.imu.verdict(self.estimator.gyro_bias(), watch),
            imu_still: self.imu.is_still(),
            speed: estimate.map_or(0.0, |estimate| estimate.speed),
            motor_speed: self.motor_speed,
            camera_speed: speeds.cameras,
            stands: speeds
                .worst()
                .is_some_and(|speed| speed < self.config.supervisor.standing_speed),
            preflight: self.preflight(),
            doubt: self.doubt(now),
            implausible_motion: self.implausible_motion(),
            contradiction: self.contradiction(),
            speed_mismatch: self.speeds.is_mismatched(),
            overspeed: self.speeds.is_overspeed(),
            commanded_speed: sensed.commanded_speed,
            filter: self.safety.ends,
            inside_fence: estimate.is_none_or(|estimate| self.stops_inside(estimate, sensed.pace)),
            late: self.ticks.is_late(watch),
            setpoint_stale: match &self.config.reference {
                Reference::External(external) => external.is_stale(now),
                _ => false,
            },
            reference_finished: match (drive_time, self.config.reference.duration()) {
                (Some(time), Some(duration)) => {
                    let governor = self.governor.as_ref();
                    governor.map_or(time, |governor| governor.path_at(time)) >= duration
                }
                _ => false,
            },
        }
    }
}
