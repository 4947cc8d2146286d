//! The judgement of a circle, from its geometry.

use singletrack_control::Limits;

use super::Finding;
use crate::config::{Config, OuterLoopSection};

/// Below this share of its limit a steady steering angle leaves room for corrections.
const STEERING_RESERVE: f64 = 0.97;

/// The circle that P and car settle on, without slip.
#[derive(Clone, Copy)]
pub(super) struct SteadyCircle {
    /// Radius of P: smaller than that of the reference without feed-forward, m.
    point: f64,
    /// The same as a factor.
    factor: f64,
    /// Angular velocity, rad/s.
    rate: f64,
    /// The smallest circle of P at the largest steering angle, m.
    least: f64,
}

impl SteadyCircle {
    /// For a reference of this radius (m) and angular velocity (rad/s).
    pub(super) fn of(config: &Config, limits: &Limits, radius: f64, rate: f64) -> Self {
        // P is an integrator per axis in a proportional loop: a first-order low pass.
        let factor = match config.outer_loop {
            OuterLoopSection::Proportional {
                gain_per_s: [x, y],
                feed_forward: false,
            } => x.min(y) / libm::hypot(x.min(y), rate),
            _ => 1.0,
        };
        let wheelbase = config.vehicle.wheelbase_m();
        let rear = wheelbase / libm::tan(limits.max_steering);
        let distance = config.law.point_distance_m;
        Self {
            point: factor * radius,
            factor,
            rate,
            least: (rear * rear + wheelbase * wheelbase + distance * distance).sqrt(),
        }
    }

    /// Radius of the rear axle's circle, m; `None` if P's circle is too small for any angle.
    fn rear_axle(&self, config: &Config) -> Option<f64> {
        let wheelbase = config.vehicle.wheelbase_m();
        let distance = config.law.point_distance_m;
        let squared = self.point * self.point - distance * distance - wheelbase * wheelbase;
        (squared > 0.0).then(|| squared.sqrt())
    }

    /// Judges the steering that it takes, for a reference that was asked for with the radius
    /// `asked` (m). Returns the radius of the rear axle's circle, m, if P can drive it.
    pub(super) fn judge_radius(
        &self,
        config: &Config,
        asked: f64,
        findings: &mut Vec<Finding>,
    ) -> Option<f64> {
        let limits = &config.limits;
        let wheelbase = config.vehicle.wheelbase_m();
        let lags = if self.factor < 1.0 {
            format!(
                ", and without outer_loop.feed_forward P settles on {:.2} m",
                self.point
            )
        } else {
            String::new()
        };
        let smallest = round_up(self.least / self.factor);
        let rear = self.rear_axle(config).filter(|_| self.point >= self.least);
        let Some(rear) = rear else {
            findings.push(Finding::impossible(
                "reference.radius_m",
                asked,
                format!(
                    "with limits.max_steering_rad = {} P can't drive a circle below {:.2} m{lags}; \
                     give at least {smallest:.2}, or lower law.point_distance_m",
                    limits.max_steering_rad, self.least
                ),
            ));
            return None;
        };
        let steering = libm::atan(wheelbase / rear);
        if steering > STEERING_RESERVE * limits.max_steering_rad {
            findings.push(Finding::warning(
                "reference.radius_m",
                asked,
                format!(
                    "the circle takes a steering angle of {steering:.3} rad of \
                     limits.max_steering_rad = {}, which leaves nothing for corrections{lags}; \
                     give {:.2} or more",
                    limits.max_steering_rad,
                    round_up(1.05 * self.least / self.factor),
                ),
            ));
        }
        Some(rear)
    }

    /// Judges the speed and the lateral acceleration that it takes.
    pub(super) fn judge_pace(&self, config: &Config, rear: f64, findings: &mut Vec<Finding>) {
        let limits = &config.limits;
        let speed = self.point * self.rate;
        if speed > limits.max_speed_m_s {
            findings.push(Finding::impossible(
                "reference.angular_velocity_rad_s",
                self.rate,
                format!(
                    "P would drive {speed:.2} m/s; limits.max_speed_m_s is {}: lower the angular \
                     velocity to {:.2} or less, or the radius",
                    limits.max_speed_m_s,
                    round_down(limits.max_speed_m_s / self.point),
                ),
            ));
        }
        // The speed of the centre of mass, and the lateral acceleration as the limit is
        // defined: v² tan δ/L.
        let centre = libm::hypot(rear, config.vehicle.rear_axle_distance_m);
        let lateral = (self.rate * centre).powi(2) / rear;
        if lateral > limits.max_lateral_acceleration_m_s2 {
            let most = (limits.max_lateral_acceleration_m_s2 * rear).sqrt() / centre;
            findings.push(Finding::impossible(
                "reference.angular_velocity_rad_s",
                self.rate,
                format!(
                    "the circle takes {lateral:.2} m/s2 of lateral acceleration; \
                     limits.max_lateral_acceleration_m_s2 is {}: lower the angular velocity to \
                     {:.2} or less",
                    limits.max_lateral_acceleration_m_s2,
                    round_down(most),
                ),
            ));
        }
    }
}

/// To two decimals, so that the advice is not below or above what is possible.
fn round_up(value: f64) -> f64 {
    (100.0 * value).ceil() / 100.0
}

fn round_down(value: f64) -> f64 {
    (100.0 * value).floor() / 100.0
}
