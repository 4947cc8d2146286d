//! The limits of plausible sensors and of tick timing.

use libm::{fabs, hypot};
use singletrack_control::InertialSample;

/// The limits of plausible sensors and of tick timing, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchConfig {
    /// The largest plausible yaw rate, rad/s.
    pub max_yaw_rate: f64,
    /// The largest plausible acceleration, m/s².
    pub max_acceleration: f64,
    /// The largest plausible gyro bias, rad/s.
    pub max_gyro_bias: f64,
    /// The number of samples in a row out of range that make the IMU implausible.
    pub implausible_samples: u32,
    /// The number of repetitions of one sample that make the IMU stuck; 0 disables the
    /// check.
    pub stuck_samples: u32,
    /// Speeds from motor and cameras may differ by this, m/s, and by a motor pulse in a
    /// span...
    pub speed_margin: f64,
    /// ...plus this fraction of the larger one.
    pub speed_ratio: f64,
    /// The car may exceed its speed limit by this, m/s.
    pub overspeed_margin: f64,
    /// The way of a motor pulse, m: a speed is known after two of them.
    pub pulse_distance: f64,
    /// The time for which poses may repeat to the last bit, s; 0 disables the check.
    pub frozen_poses: f64,
    /// The largest tilt of the IMU before the car is armed, rad.
    pub max_tilt: f64,
    /// The largest difference of roll or pitch between IMU and cameras before the car is
    /// armed, rad.
    pub max_tilt_difference: f64,
    /// The height band of the rigid body's origin, m.
    pub height: [f64; 2],
    /// The largest angle between the motion of the rear axle and the yaw, rad.
    pub max_sideslip: f64,
    /// The turn of the car may differ from that of its steering by this share.
    pub steering_ratio: f64,
    /// The largest bias of the accelerometer, m/s².
    pub max_acceleration_bias: f64,
    /// The largest normalised innovation squared of the poses, as a mean over 0.5 s.
    pub max_innovation: f64,
    /// The largest bound on the error of the poses' mid-exposure, s.
    pub max_capture_uncertainty: f64,
    /// The longest time between two ticks, s.
    pub max_gap: f64,
    /// The number of ticks that may be missed in a second.
    pub max_missed: u32,
}

impl WatchConfig {
    /// Whether a car can turn and accelerate like this. A sample that is not possible is an error of
    /// the sensor or of its bus, which has no checksum: nothing may be computed from it.
    #[must_use]
    pub fn is_possible(&self, sample: &InertialSample) -> bool {
        let acceleration = hypot(sample.forward_acceleration, sample.left_acceleration);
        // NaN is not possible either: the comparison is false.
        fabs(sample.yaw_rate) <= self.max_yaw_rate && acceleration <= self.max_acceleration
    }

    /// For the paper's car.
    #[must_use]
    pub const fn paper() -> Self {
        Self {
            max_yaw_rate: 10.0,
            max_acceleration: 35.0,
            max_gyro_bias: 0.2,
            implausible_samples: 5,
            stuck_samples: 25,
            speed_margin: 0.05,
            speed_ratio: 0.2,
            overspeed_margin: 0.4,
            pulse_distance: 0.003,
            frozen_poses: 0.3,
            max_tilt: 0.15,
            max_tilt_difference: 0.15,
            height: [f64::NEG_INFINITY, f64::INFINITY],
            max_sideslip: 0.14,
            steering_ratio: 0.5,
            max_acceleration_bias: 2.5,
            max_innovation: 200.0,
            max_capture_uncertainty: 0.02,
            max_gap: 0.08,
            max_missed: 20,
        }
    }
}
