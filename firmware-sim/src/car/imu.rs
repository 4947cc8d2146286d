//! The inertial measurement unit, after the BNO055 in its fusion mode without
//! magnetometer.

use serde::{Deserialize, Serialize};

use super::Truth;
use crate::{
    attitude,
    random::{Random, Stream},
};

/// The IMU's rate, noise and biases. It sits at the centre of mass with its
/// axes forward, left, up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImuParameters {
    /// Time between samples, in µs.
    pub period_us: u64,
    /// Time of the first sample, in µs.
    pub phase_us: u64,
    /// Time from the moment measured until the board has the sample, in µs.
    pub latency_us: u64,
    /// Standard deviation of the angular velocity, in rad/s.
    pub gyro_noise_rad_s: f64,
    /// Standard deviation of the constant bias drawn at start, in rad/s.
    pub gyro_bias_rad_s: f64,
    /// Random walk of the bias, in rad/s per square root of a second.
    pub gyro_walk_rad_s: f64,
    /// Standard deviation of the linear acceleration, in m/s².
    pub acceleration_noise_m_s2: f64,
    /// Standard deviation of the constant bias drawn at start, in m/s².
    pub acceleration_bias_m_s2: f64,
    /// Standard deviation of roll, pitch and yaw, in rad.
    pub attitude_noise_rad: f64,
    /// Random walk of the yaw, in rad per square root of a second.
    pub yaw_walk_rad: f64,
}

impl Default for ImuParameters {
    fn default() -> Self {
        Self {
            period_us: 10_000,
            phase_us: 3_700,
            latency_us: 1_200,
            gyro_noise_rad_s: 0.003,
            gyro_bias_rad_s: 0.005,
            gyro_walk_rad_s: 0.000_1,
            acceleration_noise_m_s2: 0.06,
            acceleration_bias_m_s2: 0.05,
            attitude_noise_rad: 0.001,
            yaw_walk_rad: 0.001,
        }
    }
}

/// One sample, in the units of the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImuReading {
    /// Simulation time of the moment measured, in µs.
    pub time_us: u64,
    /// Acceleration without gravity along forward, left, up, in mm/s².
    pub linear_acceleration_mm_s2: [i16; 3],
    /// Angular velocity about forward, left, up, in mrad/s.
    pub angular_velocity_mrad_s: [i16; 3],
    /// Attitude as a unit quaternion w, x, y, z, scaled by 2^14.
    pub attitude_q14: [i16; 4],
}

/// The sensor's own state: biases and drift.
#[derive(Clone, Debug)]
pub(crate) struct Imu {
    parameters: ImuParameters,
    gyro_random: Random,
    acceleration_random: Random,
    attitude_random: Random,
    gyro_bias: [f64; 3],
    acceleration_bias: [f64; 3],
    yaw_drift: f64,
}

impl Imu {
    pub(crate) fn new(parameters: ImuParameters, seed: u64) -> Self {
        let mut gyro_random = Random::new(seed, Stream::Gyroscope);
        let mut acceleration_random = Random::new(seed, Stream::Accelerometer);
        let gyro_bias = gyro_random.normal3(parameters.gyro_bias_rad_s);
        let acceleration_bias = acceleration_random.normal3(parameters.acceleration_bias_m_s2);
        Self {
            parameters,
            gyro_random,
            acceleration_random,
            attitude_random: Random::new(seed, Stream::Attitude),
            gyro_bias,
            acceleration_bias,
            yaw_drift: 0.0,
        }
    }

    /// The constant and walked bias of the angular velocity, in rad/s.
    pub(crate) const fn gyro_bias(&self) -> [f64; 3] {
        self.gyro_bias
    }

    /// Measures; to be called once every period.
    pub(crate) fn sample(&mut self, truth: &Truth) -> ImuReading {
        let p = &self.parameters;
        let root_period = libm::sqrt(p.period_us as f64 * 1e-6);
        let walk = self.gyro_random.normal3(p.gyro_walk_rad_s * root_period);
        let gyro_noise = self.gyro_random.normal3(p.gyro_noise_rad_s);
        let acceleration_noise = self.acceleration_random.normal3(p.acceleration_noise_m_s2);
        self.yaw_drift += self.attitude_random.normal() * p.yaw_walk_rad * root_period;
        let tilt = self.attitude_random.normal3(p.attitude_noise_rad);

        let rate = [0.0, 0.0, truth.yaw_rate];
        let acceleration = [
            truth.longitudinal_acceleration,
            truth.lateral_acceleration,
            0.0,
        ];
        let mut angular_velocity_mrad_s = [0; 3];
        let mut linear_acceleration_mm_s2 = [0; 3];
        for axis in 0..3 {
            self.gyro_bias[axis] += walk[axis];
            angular_velocity_mrad_s[axis] =
                quantise((rate[axis] + self.gyro_bias[axis] + gyro_noise[axis]) * 1e3);
            linear_acceleration_mm_s2[axis] = quantise(
                (acceleration[axis] + self.acceleration_bias[axis] + acceleration_noise[axis])
                    * 1e3,
            );
        }
        ImuReading {
            time_us: truth.time_us,
            linear_acceleration_mm_s2,
            angular_velocity_mrad_s,
            attitude_q14: attitude::quaternion_wxyz(
                truth.yaw + self.yaw_drift + tilt[2],
                tilt[0],
                tilt[1],
            )
            .map(|component| quantise(component * 16384.0)),
        }
    }
}

/// Rounds to the message's unit, saturating as the sensor does.
fn quantise(value: f64) -> i16 {
    // `as` saturates and turns NaN into zero.
    value.round() as i16
}
