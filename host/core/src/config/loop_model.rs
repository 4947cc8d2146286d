//! The outer loops with a model: their weights, and what they believe of the car and of its reference.

use libm::{sqrt, tan};
use singletrack_control::{
    ActuatorModel, ConvexArea, DelayedMpc, Limits, LqiAxis, LqiConfig, LqiError, LqiLoop,
    MpcConfig, MpcError, Reference, angle_between,
};
use singletrack_pilot::Fence;

use singletrack_settings::section;

use super::ConfigError;

section! {
    /// The settings of the linear-quadratic loop.
    "outer_loop" => pub LqiWeights: Copy;
    [default];

    /// Weight of the error's integral, (m s)⁻².
    integral_weight: f64 = 3.0;
    /// Weight of the error, m⁻².
    error_weight: f64 = ERROR_WEIGHT;
    /// Weight of the correcting velocity, (m/s)⁻².
    velocity_weight: f64 = VELOCITY_WEIGHT;
    /// The largest velocity that the integral adds on either axis, m/s.
    integral_limit_m_s: f64 = 0.3;
}

section! {
    /// The settings of the predictive loop.
    "outer_loop" => pub MpcWeights: Copy;
    [default];

    /// Weight of the error, m⁻².
    error_weight: f64 = ERROR_WEIGHT;
    /// Weight of the velocity's error, (m/s)⁻².
    velocity_weight: f64 = VELOCITY_WEIGHT;
    /// Weight of the acceleration beyond the reference's, (m/s²)⁻².
    acceleration_weight: f64 = 0.0003;
    /// The share of an unexplained velocity that is believed at once.
    disturbance_gain: f64 = 0.05;
    /// Iterations of the solver in every tick.
    iterations: u32 = 20;
}

pub(super) const ERROR_WEIGHT: f64 = 1.0;
pub(super) const VELOCITY_WEIGHT: f64 = 0.03;

/// The length of a stage of the predictive loop's plan, where no dead time sets it, in s.
const STAGE_S: f64 = 0.03;

/// For how long a reference without an end is looked at, and at which steps, in s.
const LOOKED_AT_S: f64 = 120.0;
const LOOK_S: f64 = 0.01;
/// Below this speed (m/s) a reference has no direction.
const STANDS_M_S: f64 = 0.02;

/// What the outer loops with a model believe.
#[derive(Clone, Copy, Debug)]
pub struct LoopModel<'a> {
    /// Lags and dead times; none where they are compensated, or where there are none.
    pub actuators: Option<ActuatorModel>,
    /// What the car may do.
    pub limits: &'a Limits,
    /// Where it may be, if that is bounded.
    pub fence: Option<&'a Fence>,
    /// Where P should be.
    pub reference: &'a Reference,
    /// The control period, s.
    pub period: f64,
}

impl LoopModel<'_> {
    pub(super) fn lqi(&self, weights: &LqiWeights) -> Result<LqiLoop, ConfigError> {
        let LqiWeights {
            integral_weight,
            error_weight,
            velocity_weight,
            integral_limit_m_s,
        } = *weights;
        let axis = |lag| LqiAxis {
            lag,
            integral_weight,
            error_weight,
            velocity_weight,
        };
        let lag = |of: fn(&ActuatorModel) -> f64| self.actuators.as_ref().map_or(0.0, of);
        LqiLoop::new(LqiConfig {
            along: axis(lag(|model| model.speed_dead_time + model.speed_lag)),
            across: axis(lag(|model| model.steering_dead_time + model.steering_lag)),
            integral_limit: integral_limit_m_s,
            turn_rate: self.turn_rate(),
            period: self.period,
        })
        .map_err(|error| match error {
            LqiError::Turns(rate) => ConfigError::value(
                "outer_loop.velocity_weight",
                velocity_weight,
                format!(
                    "the loop does not settle while the reference turns by {rate:.2} rad/s with \
                     the lags of [actuators]; lower it, set compensation.actuation = true, or \
                     drive slower"
                ),
            ),
            error => ConfigError::value(
                "outer_loop.error_weight",
                error_weight,
                format!("{error}; bring the weights closer to their defaults"),
            ),
        })
    }

    pub(super) fn mpc(&self, weights: &MpcWeights) -> Result<DelayedMpc, ConfigError> {
        let area = match self.fence {
            None => None,
            Some(fence) => Some(area(fence)?),
        };
        let mean = |of: fn(&ActuatorModel) -> [f64; 2]| {
            self.actuators.as_ref().map_or(0.0, |model| {
                let [steering, speed] = of(model);
                0.5 * (steering + speed)
            })
        };
        let dead_time = mean(|model| [model.steering_dead_time, model.speed_dead_time]);
        let config = MpcConfig {
            lag: mean(|model| [model.steering_lag, model.speed_lag]),
            period: self.period,
            ticks_per_stage: (STAGE_S / self.period).round().max(1.0) as usize,
            position_weight: weights.error_weight,
            velocity_weight: weights.velocity_weight,
            acceleration_weight: weights.acceleration_weight,
            max_speed: self.limits.max_speed,
            // The car speeds up and turns at the same time.
            max_acceleration: libm::hypot(
                self.limits.max_acceleration,
                self.limits.max_lateral_acceleration,
            ),
            max_deceleration: self.limits.max_acceleration,
            area,
            iterations: weights.iterations as usize,
            disturbance_gain: weights.disturbance_gain,
        };
        DelayedMpc::new(config, dead_time).map_err(|error| match error {
            MpcError::Delay(_) => ConfigError::value(
                "actuators.speed_dead_time_ms",
                self.actuators
                    .map_or(0.0, |model| 1_000.0 * model.speed_dead_time),
                "the predictive loop does not look over so long a dead time; set \
                 compensation.actuation = true, or choose outer_loop.kind = \"proportional\"",
            ),
            error => ConfigError::value(
                "outer_loop.error_weight",
                weights.error_weight,
                format!("{error}; bring the weights closer to their defaults"),
            ),
        })
    }

    /// The fastest turn that the reference's frame has to stand, rad/s: that of the reference,
    /// and not more than the car's.
    fn turn_rate(&self) -> f64 {
        let Limits {
            max_speed,
            max_lateral_acceleration,
            max_steering,
            wheelbase,
            ..
        } = *self.limits;
        // Slower, the steering angle limits the turn, and faster, the lateral acceleration.
        let curvature = tan(max_steering) / wheelbase;
        let fastest = sqrt(max_lateral_acceleration / curvature).min(max_speed);
        (curvature * fastest).min(turn_rate(self.reference))
    }
}

/// The fastest turn of the reference, rad/s; infinite where it jumps, or is not known.
fn turn_rate(reference: &Reference) -> f64 {
    if matches!(
        reference,
        Reference::External(_) | Reference::Waypoints(_) | Reference::VelocitySteps(_)
    ) {
        return f64::INFINITY;
    }
    let duration = reference.duration().unwrap_or(LOOKED_AT_S).min(LOOKED_AT_S);
    let steps = (duration / LOOK_S) as u32;
    let velocity = |step: u32| reference.at(f64::from(step) * LOOK_S).velocity;
    (0..steps)
        .map(|step| (velocity(step), velocity(step + 1)))
        .filter(|(before, after)| before.norm().min(after.norm()) >= STANDS_M_S)
        .map(|(before, after)| angle_between(&before, &after).abs() / LOOK_S)
        .fold(0.0, f64::max)
}

/// Where P may be: the geofence within its margin.
fn area(fence: &Fence) -> Result<ConvexArea, ConfigError> {
    ConvexArea::new(fence.corners())
        .and_then(|area| area.shrunk(fence.margin()))
        .map_err(|error| {
            ConfigError::value(
                "outer_loop.kind",
                "mpc",
                format!(
                    "it plans inside the geofence, but of fence.corners_m {error}; give a convex \
                     fence that is wider than its margin, or use \"lqi\""
                ),
            )
        })
}
