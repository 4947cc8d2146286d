//! What a tick senses: events to estimate and speeds.

use libm::fabs;
use singletrack_control::{Estimate, PoseVerdict, Time};

use super::Pilot;
use crate::{event::Event, watch::Speeds};

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
        let (steering, config) = (self.commanded_steering, &self.config);
        self.watches
            .observe_tick(now, estimate.as_ref(), pace, steering, config);
        let braking = self.watches.braking(config);
        let wave = self.wave();
        self.safety.observe(pace, steering, braking, config.period);
        self.safety.watch(estimate.as_ref(), wave, config.period);
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
}
