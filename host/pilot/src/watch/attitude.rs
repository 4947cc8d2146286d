//! Attitude, height and clock of the sensors, and the direction of a car that is pushed.

use libm::{atan2, cos, fabs, hypot, sin};
use singletrack_control::Time;

use super::{config::WatchConfig, steps::Step};
use crate::{
    event::{AttitudeSample, Tilt},
    supervisor::Reason,
};

/// The number of samples in a row with an uncertain mid-exposure: 0.5 s.
const UNCERTAIN: u32 = 5;

/// The age of a sample at which it counts no longer, s.
const AGE: f64 = 0.5;

/// The latest attitude of IMU and body.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct AttitudeWatch {
    imu: Option<(Tilt, Heard)>,
    body: Option<(Tilt, Heard)>,
    height: Option<(f64, Heard)>,
    uncertain: u32,
}

/// The tick that handled a sample; `None` in that tick.
type Heard = Option<Time>;

impl AttitudeWatch {
    /// A sample.
    pub(crate) fn handle(&mut self, sample: &AttitudeSample, config: &WatchConfig) {
        if let Some(imu) = sample.imu {
            self.imu = Some((imu, None));
        }
        if let Some(body) = sample.body {
            self.body = Some((body, None));
        }
        if let Some(height) = sample.height {
            self.height = Some((height, None));
        }
        if let Some(uncertainty) = sample.capture_uncertainty {
            self.uncertain = if uncertainty <= config.max_capture_uncertainty {
                0
            } else {
                self.uncertain.saturating_add(1)
            };
        }
    }

    /// A tick: dates the samples since the last one.
    pub(crate) fn tick(&mut self, now: Time) {
        date(&mut self.imu, now);
        date(&mut self.body, now);
        date(&mut self.height, now);
    }

    /// What forbids to arm; the body's axes are turned by `marker_yaw` (rad) against the
    /// car's.
    pub(crate) fn check(&self, marker_yaw: f64, config: &WatchConfig) -> Option<Reason> {
        // A NaN is within no limit.
        let level = |tilt: Tilt| hypot(tilt.roll, tilt.pitch) <= config.max_tilt;
        if let Some((tilt, _)) = self.imu
            && !level(tilt)
        {
            return Some(Reason::ImuTilted);
        }
        if let (Some((imu, _)), Some((body, _))) = (self.imu, self.body) {
            let (c, s) = (cos(marker_yaw), sin(marker_yaw));
            // Tilts are small: they turn as vectors do.
            let roll = c * body.roll + s * body.pitch;
            let pitch = c * body.pitch - s * body.roll;
            let most = fabs(imu.roll - roll).max(fabs(imu.pitch - pitch));
            let agree = most <= config.max_tilt_difference;
            if !agree {
                return Some(Reason::TiltDiffers);
            }
        }
        let [low, high] = config.height;
        if let Some((height, _)) = self.height
            && !(low <= height && height <= high)
        {
            return Some(Reason::PoseHeight);
        }
        None
    }

    /// Whether the mid-exposure of the poses has been uncertain for too long.
    pub(crate) const fn is_uncertain(&self) -> bool {
        self.uncertain >= UNCERTAIN
    }
}

fn date<T>(value: &mut Option<(T, Heard)>, now: Time) {
    match value {
        Some((_, heard @ None)) => *heard = Some(now),
        Some((_, Some(heard))) if now.seconds_since(*heard) > AGE => *value = None,
        _ => {}
    }
}

/// The line along which a car that is not driven was rolled by hand.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PushWatch {
    along: f64,
    across: f64,
    motor_way: f64,
    is_wrong: bool,
}

/// The way that the car must roll, m.
const ROLLED: f64 = 0.2;
/// A step must be at least this long, m: a standing car has noise.
const STEP: f64 = 0.004;
/// Above this angle the yaw is wrong, and below the second it is right again, rad.
const WRONG: (f64, f64) = (0.17, 0.1);
/// The largest turn of a step, rad: the car is rolled straight.
const STRAIGHT: f64 = 0.05;
/// The share by which the way of the wheels may differ: they roll, and the car is not
/// carried.
const ROLLS: f64 = 0.25;

impl PushWatch {
    /// A step of a car that is not driven.
    pub(crate) fn step(&mut self, step: &Step) {
        let way = step.rear.norm();
        let rolls = fabs(step.motor_way - way) <= ROLLS * way;
        if way < STEP || fabs(step.turn) > STRAIGHT || !rolls {
            *self = Self {
                is_wrong: self.is_wrong,
                ..Self::default()
            };
            return;
        }
        self.along += step.along();
        self.across += step.across();
        self.motor_way += step.motor_way;
        if self.motor_way >= ROLLED {
            // The pulses have no sign: a car rolls backward as well. A body that is turned by
            // a right angle or more shows in the first metre.
            let angle = fabs(atan2(self.across, fabs(self.along)));
            let (wrong, right) = WRONG;
            self.is_wrong = angle > wrong || (self.is_wrong && angle > right);
            *self = Self {
                is_wrong: self.is_wrong,
                ..Self::default()
            };
        }
    }

    /// Whether the yaw of the body does not fit the last motion.
    pub(crate) const fn is_wrong(&self) -> bool {
        self.is_wrong
    }
}
