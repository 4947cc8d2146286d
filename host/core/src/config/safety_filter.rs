//! `[safety_filter]`: the filter between any outer loop and the law.

use singletrack_control::{GRAVITY, MAX_STEERING_TICKS, SafetyConfig, SafetyFilter};
use singletrack_settings::section;

use super::{Config, ConfigError};

section! {
    /// Keeps the car able to stop inside the geofence, whatever an outer loop asks for: ours, a
    /// program's velocities, trajectories, or steering and speed. `docs/safety-filter.md` states
    /// the claim and what it rests on: these errors, `[actuators]`, and `fence.braking_m_s2` or
    /// what a stop has measured. It needs a convex geofence.
    "safety_filter" => pub SafetyFilterSection: Copy;
    [default];

    /// Whether there is one.
    enabled: bool = false;
    /// Time from a tick to when a car that is told to stop slows down at the latest. The default
    /// is the motor's dead time and lag, and 80 ms for line, board and the frame of the ESC.
    reaction_ms: Option<f64> = None, in 50.0..=2_000.0, example 196.0;
    /// The most by which a moving car becomes faster than it is measured and commanded.
    speed_error_m_s: f64 = 0.1, in 0.0..=1.0;
    /// Largest error of the estimated position: cameras, the body on the car, its stamps.
    position_error_m: f64 = 0.03, in 0.0..=0.5;
    /// Largest error of the direction of motion, beyond the sideslip of the rolling car and of
    /// the estimate.
    course_error_rad: f64 = 0.05, in 0.0..=0.5;
    /// Largest deviation of the path's curvature from that of the steering angle: trim, play and
    /// gain of the servo, slip of the tyres.
    curvature_error_per_m: f64 = 0.5, in 0.0..=5.0;
}

/// Line, board and the frame of a servo or an ESC, ms.
const LINE_MS: f64 = 40.0;
/// The lags of a servo after which it is where it was sent, but for a twentieth of the change.
const SETTLED: f64 = 3.0;

impl SafetyFilterSection {
    /// Time from a tick to when this car slows down at the latest, ms.
    pub(super) fn reaction_ms(&self, config: &Config) -> f64 {
        let actuators = &config.actuators;
        self.reaction_ms
            .unwrap_or(actuators.speed_dead_time_ms + actuators.speed_lag_ms + 2.0 * LINE_MS)
    }

    /// For the controller of this car; none if it is not enabled.
    ///
    /// # Errors
    ///
    /// The geofence is not convex or nothing is left of it, or the servo is slower than the
    /// filter follows it.
    pub(super) fn filter(&self, config: &Config) -> Result<Option<SafetyFilter>, ConfigError> {
        if !self.enabled {
            return Ok(None);
        }
        let area = config.fence.convex(&config.vehicle, "safety_filter")?;
        let actuators = &config.actuators;
        let settled_ms =
            actuators.steering_dead_time_ms + SETTLED * actuators.steering_lag_ms + LINE_MS;
        let period_ms = f64::from(config.control.period_ms);
        let ticks = (settled_ms / period_ms).ceil();
        let most = MAX_STEERING_TICKS - 1;
        if ticks > most as f64 {
            return Err(ConfigError::value(
                "actuators.steering_lag_ms",
                actuators.steering_lag_ms,
                format!(
                    "the servo needs {settled_ms} ms (its dead time, {SETTLED} lags and \
                     {LINE_MS} ms), and the safety filter follows it for {} ms at \
                     control.period_ms = {period_ms}; raise that, use a faster servo, or set \
                     safety_filter.enabled = false",
                    most as f64 * period_ms
                ),
            ));
        }
        let reaction_ms = self.reaction_ms(config);
        let limits = config.limits.limits(config.vehicle.wheelbase_m());
        SafetyFilter::new(SafetyConfig {
            area,
            reaction: 1e-3 * reaction_ms,
            steering_ticks: ticks as usize,
            position_error: self.position_error_m,
            course_error: self.course_error_rad,
            curvature_error: self.curvature_error_per_m,
            speed_error: self.speed_error_m_s,
            max_speed: config.limits.max_speed_m_s,
            // The law keeps to the configured limit. Beyond that of the tyres they slide.
            max_lateral_acceleration: config.vehicle.friction * GRAVITY,
            slip: limits.with_tyres(&config.vehicle).slip.max(0.0),
            wheelbase: config.vehicle.wheelbase_m(),
        })
        .map(Some)
        .map_err(|error| ConfigError::value("safety_filter", error.name, error.to_string()))
    }
}
