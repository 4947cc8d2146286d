//! Consistency of poses, estimate and clock during every drive.

use libm::{atan2, copysign, fabs, tan};
use singletrack_control::{PoseSample, Time};

use super::{config::WatchConfig, steps::Step};

/// Poses that repeat to the last bit.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FrozenWatch {
    last: Option<PoseSample>,
    since: Option<Time>,
    frozen: bool,
}

impl FrozenWatch {
    /// A pose of the cameras, accepted or not.
    pub(crate) fn pose(&mut self, pose: &PoseSample, config: &WatchConfig) {
        let bits =
            |pose: &PoseSample| [pose.position.x, pose.position.y, pose.yaw].map(f64::to_bits);
        let equal = self.last.is_some_and(|last| bits(&last) == bits(pose));
        if equal {
            let since = *self
                .since
                .get_or_insert(self.last.map_or(pose.capture, |last| last.capture));
            self.frozen = config.frozen_poses > 0.0
                && pose.capture.seconds_since(since) >= config.frozen_poses;
        } else {
            self.since = None;
            self.frozen = false;
        }
        self.last = Some(*pose);
    }

    /// Whether the poses repeat for too long.
    pub(crate) const fn is_frozen(&self) -> bool {
        self.frozen
    }
}

/// The angle between the motion of the rear axle and the yaw, as a mean over a way.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SideslipWatch {
    along: f64,
    across: f64,
    allowed: f64,
    way: f64,
    exceeded: u32,
}

/// The way of one mean, m.
const WAY: f64 = 0.25;
/// The number of means in a row beyond the limit.
const MEANS: u32 = 2;
/// What the tyres of a car add, rad per m/s² of lateral acceleration.
const SLIP: f64 = 0.03;

impl SideslipWatch {
    /// A step of a drive.
    pub(crate) fn step(&mut self, step: &Step, config: &WatchConfig) {
        let way = step.rear.norm();
        // The noise of a pose; and a car in reverse slides the other way.
        if way < 0.003 || step.motor_way < 0.0 {
            return;
        }
        let lateral = fabs(way * step.turn) / (step.time * step.time);
        self.along += step.along();
        self.across += step.across();
        self.allowed += way * (config.max_sideslip + SLIP * lateral);
        self.way += way;
        if self.way >= WAY {
            let angle = fabs(atan2(self.across, self.along));
            // A NaN exceeds it.
            self.exceeded = if angle <= self.allowed / self.way {
                0
            } else {
                self.exceeded.saturating_add(1)
            };
            *self = Self {
                exceeded: self.exceeded,
                ..Self::default()
            };
        }
    }

    /// Whether the sideslip is implausible.
    pub(crate) const fn is_exceeded(&self) -> bool {
        self.exceeded >= MEANS
    }

    /// Forgets the last drive.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }
}

/// Turn and steering, as sums over a way.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SteeringWatch {
    wanted: f64,
    made: f64,
    way: f64,
    exceeded: u32,
}

/// The way of one comparison, m.
const STEERED_WAY: f64 = 0.4;
/// The turns may differ by this, rad: a bent course has lags, and a floor has bumps.
const STEERED_MARGIN: f64 = 0.2;
/// The number of comparisons in a row beyond the limit.
const STEERED_TIMES: u32 = 2;

impl SteeringWatch {
    /// A step of a drive; `wheelbase` in m.
    pub(crate) fn step(&mut self, step: &Step, wheelbase: f64, config: &WatchConfig) {
        let way = step.rear.norm();
        self.wanted += copysign(way, step.motor_way) * tan(step.steering) / wheelbase;
        self.made += step.turn;
        self.way += way;
        if self.way >= STEERED_WAY {
            let allowed = STEERED_MARGIN + config.steering_ratio * fabs(self.wanted);
            // A NaN exceeds it.
            let fits = fabs(self.made - self.wanted) <= allowed;
            *self = Self {
                exceeded: if fits {
                    0
                } else {
                    self.exceeded.saturating_add(1)
                },
                ..Self::default()
            };
        }
    }

    /// Whether the car turns otherwise than it is steered.
    pub(crate) const fn is_exceeded(&self) -> bool {
        self.exceeded >= STEERED_TIMES
    }

    /// Forgets the last drive.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }
}

/// The normalised innovation squared of the poses, as a running mean.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct InnovationWatch {
    mean: f64,
    /// Poses in a row with too high a mean.
    exceeded: u32,
}

/// The share of a new pose in the mean: 0.5 s at 100 Hz.
const SHARE: f64 = 0.02;
/// The number of poses for which the mean must exceed its limit, 0.5 s at 100 Hz: other
/// watches name the cause by then.
const POSES: u32 = 50;

impl InnovationWatch {
    /// An accepted pose with this innovation.
    pub(crate) fn pose(&mut self, innovation: f64, config: &WatchConfig) {
        self.mean += SHARE * (innovation - self.mean);
        // A NaN exceeds it.
        self.exceeded = if self.mean <= config.max_innovation {
            0
        } else {
            self.exceeded.saturating_add(1)
        };
    }

    /// Whether the innovations exceed their limit.
    pub(crate) const fn is_inconsistent(&self) -> bool {
        self.exceeded >= POSES
    }

    /// Forgets the last drive.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }
}
