//! Noise levels of the sensors and of the road, and how they are measured.

use singletrack_control::{GRAVITY, VehicleParameters, wrap};

use super::data::{Channel, DriveData, MEDIAN_OF_NORMAL, Span};

/// Standard deviations of measurement and process noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseLevels {
    /// Noise of each coordinate of a pose, in m.
    pub position_m: f64,
    /// Noise of the yaw of a pose, in rad.
    pub yaw_rad: f64,
    /// Noise of a sample of the gyro, in rad/s.
    pub yaw_rate_rad_s: f64,
    /// Noise of a sample of the acceleration to the left, in m/s².
    pub left_m_s2: f64,
    /// Density of the noise of the acceleration forward, in m/s²/√Hz.
    pub forward_density: f64,
    /// Density of the unmodelled force on each axle, in N/√Hz.
    pub force_density: f64,
    /// Random walk of the gyro's bias, in rad/s/√s.
    pub gyro_walk: f64,
    /// Random walk of the bias of the acceleration forward, in m/s²/√s.
    pub forward_walk: f64,
}

/// The smallest force density on an axle, which the filter needs, in N/√Hz.
pub(super) const LEAST_FORCE: f64 = 1e-6;

/// The least standard deviations that the fit believes of a sensor. Samples that are held, rounded or
/// smoothed by the sensor have third differences of nearly zero; with levels as small as that, the filter
/// would trust single samples to the last digit.
const LEAST: NoiseLevels = NoiseLevels {
    position_m: 5e-5,
    yaw_rad: 3e-4,
    yaw_rate_rad_s: 1e-3,
    left_m_s2: 0.02,
    ..NoiseLevels::exact()
};

impl NoiseLevels {
    /// Start values of their estimation: a good motion capture system, and a consumer IMU on
    /// a vibrating car.
    pub const fn usual() -> Self {
        Self {
            position_m: 3e-4,
            yaw_rad: 2e-3,
            yaw_rate_rad_s: 5e-3,
            left_m_s2: 0.1,
            forward_density: 0.02,
            force_density: 3e-3,
            gyro_walk: 1e-4,
            forward_walk: 2e-3,
        }
    }

    /// Levels with which the filter follows the sensors, whatever the car: a bad IMU on a bad floor, and a
    /// model that explains little.
    pub(super) fn loose(vehicle: &VehicleParameters) -> Self {
        Self {
            position_m: 1e-3,
            yaw_rad: 3e-3,
            yaw_rate_rad_s: 0.05,
            left_m_s2: 1.0,
            forward_density: 0.3,
            force_density: 0.02 * vehicle.mass_kg * GRAVITY,
            gyro_walk: 1e-4,
            forward_walk: 0.05,
        }
    }

    /// Nearly exact sensors and model, as the base of other levels. The filter needs every
    /// level to be above zero.
    pub const fn exact() -> Self {
        Self {
            position_m: 1e-6,
            yaw_rad: 1e-6,
            yaw_rate_rad_s: 1e-6,
            left_m_s2: 1e-6,
            forward_density: 1e-6,
            force_density: LEAST_FORCE,
            gyro_walk: 1e-9,
            forward_walk: 1e-9,
        }
    }

    /// The standard deviation of a sample of `channel`.
    pub(super) const fn of(&self, channel: Channel) -> f64 {
        match channel {
            Channel::X | Channel::Y => self.position_m,
            Channel::Yaw => self.yaw_rad,
            Channel::YawRate => self.yaw_rate_rad_s,
            Channel::Left => self.left_m_s2,
        }
    }

    /// These levels, with those of the sensors from third differences of the samples.
    ///
    /// Independent of the model: the car's motion has small third differences.
    pub(super) fn with_measured_sensors(self, data: &DriveData, spans: &[Span]) -> Self {
        let within = |time: f64| spans.iter().any(|span| span.contains(time));
        let poses = data.poses.windows(4);
        let poses = poses.filter(|w| w.iter().all(|p| within(p.time_s)));
        let (mut position, mut yaw) = (Vec::new(), Vec::new());
        for window in poses {
            if let [a, b, c, d] = window {
                position.push(third([a.x_m, b.x_m, c.x_m, d.x_m]));
                position.push(third([a.y_m, b.y_m, c.y_m, d.y_m]));
                let turned = [b, c, d].map(|pose| wrap(pose.yaw_rad - a.yaw_rad));
                yaw.push(third([0.0, turned[0], turned[1], turned[2]]));
            }
        }
        let inertial = data.inertial.windows(4);
        let inertial = inertial.filter(|w| w.iter().all(|i| within(i.time_s)));
        let (mut yaw_rate, mut left) = (Vec::new(), Vec::new());
        for window in inertial {
            if let [a, b, c, d] = window {
                yaw_rate.push(third([a, b, c, d].map(|sample| sample.yaw_rate_rad_s)));
                left.push(third([a, b, c, d].map(|sample| sample.left_m_s2)));
            }
        }
        // What is not measured.
        yaw_rate.retain(|difference: &f64| !difference.is_nan());
        left.retain(|difference: &f64| !difference.is_nan());
        let level = |differences, usual: f64, least: f64| {
            deviation(differences).map_or(usual, |measured| measured.max(least))
        };
        Self {
            position_m: level(position, self.position_m, LEAST.position_m),
            yaw_rad: level(yaw, self.yaw_rad, LEAST.yaw_rad),
            yaw_rate_rad_s: level(yaw_rate, self.yaw_rate_rad_s, LEAST.yaw_rate_rad_s),
            left_m_s2: level(left, self.left_m_s2, LEAST.left_m_s2),
            ..self
        }
    }
}

/// The third difference; of white noise it has twenty times the variance.
fn third([a, b, c, d]: [f64; 4]) -> f64 {
    d - 3.0 * c + 3.0 * b - a
}

/// Standard deviation of white noise with these third differences, from their median, which
/// is robust against jolts. None if there are too few, or if most are zero.
fn deviation(mut differences: Vec<f64>) -> Option<f64> {
    for difference in &mut differences {
        *difference = difference.abs();
    }
    differences.sort_by(f64::total_cmp);
    let median = differences.get(differences.len() / 2)?;
    (*median > 0.0 && differences.len() >= 100).then(|| median / (MEDIAN_OF_NORMAL * 20_f64.sqrt()))
}
