//! The settings of the outer loops with a model.

use singletrack_settings::section;

section! {
    /// The settings of the linear-quadratic loop.
    "outer_loop" => pub LqiWeights: Copy;
    [default];

    /// Of the error's integral, (m s)⁻².
    integral_weight: f64 = 3.0;
    /// Of the error, m⁻².
    error_weight: f64 = ERROR_WEIGHT;
    /// Of the correcting velocity, (m/s)⁻².
    velocity_weight: f64 = VELOCITY_WEIGHT;
    /// The largest velocity that the integral adds on either axis, m/s.
    integral_limit_m_s: f64 = 0.3;
}

section! {
    /// The settings of the predictive loop.
    "outer_loop" => pub MpcWeights: Copy;
    [default];

    /// Of the error, m⁻².
    error_weight: f64 = ERROR_WEIGHT;
    /// Of the velocity's error, (m/s)⁻².
    velocity_weight: f64 = VELOCITY_WEIGHT;
    /// Of the acceleration beyond the reference's, (m/s²)⁻².
    acceleration_weight: f64 = 0.0003;
    /// The share of an unexplained velocity that is believed at once.
    disturbance_gain: f64 = 0.05;
    /// Iterations of the solver in every tick.
    iterations: u32 = 20;
}

pub(super) const ERROR_WEIGHT: f64 = 1.0;
pub(super) const VELOCITY_WEIGHT: f64 = 0.03;
