//! The inertial measurement unit, modelled on the BNO055 in its fusion mode without
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
    /// Time from the measurement to the arrival at the board, in µs.
    pub latency_us: u64,
    /// Standard deviation of the angular velocity, in rad/s.
    pub gyro_noise_rad_s: f64,
    /// Standard deviation of the constant bias of the angular velocity, in rad/s.
    pub gyro_bias_rad_s: f64,
    /// Random walk of the bias, in rad/s per square root of a second.
    pub gyro_walk_rad_s: f64,
    /// Standard deviation of the linear acceleration, in m/s².
    pub acceleration_noise_m_s2: f64,
    /// Standard deviation of the constant bias of the acceleration, in m/s².
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
    /// Simulation time of the measurement, in µs.
    pub time_us: u64,
    /// Acceleration without gravity along forward, left, up, in mm/s².
    pub linear_acceleration_mm_s2: [i16; 3],
    /// Angular velocity about forward, left, up, in mrad/s.
    pub angular_velocity_mrad_s: [i16; 3],
    /// Attitude as a unit quaternion w, x, y, z, scaled by 2^14.
    pub attitude_q14: [i16; 4],
}

/// Faults of the IMU, beyond its noise and biases.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ImuFault {
    /// No fault.
    #[default]
    None,
    /// No samples.
    Silent,
    /// All samples repeat the values of the last good one.
    Stuck,
    /// A further bias of the angular velocity about the vertical, in mrad/s, and of
    /// the forward acceleration, in mm/s².
    Biased {
        /// Bias of the angular velocity about the vertical, in mrad/s.
        yaw_rate_mrad_s: i16,
        /// Bias of the forward acceleration, in mm/s².
        forward_mm_s2: i16,
    },
    /// All values at full scale, which sensors without NaN use for errors.
    Saturated,
    /// Every other sample has its signs reversed.
    Erratic,
}

impl ImuFault {
    /// The sample that the board gets for `reading`; `last` is the previous one.
    pub(crate) fn falsify(
        self,
        mut reading: ImuReading,
        last: Option<ImuReading>,
        number: u64,
    ) -> Option<ImuReading> {
        match self {
            Self::None => {}
            Self::Silent => return None,
            Self::Stuck => {
                let time_us = reading.time_us;
                reading = ImuReading {
                    time_us,
                    ..last.unwrap_or(reading)
                };
            }
            Self::Biased {
                yaw_rate_mrad_s,
                forward_mm_s2,
            } => {
                let [_, _, yaw_rate] = &mut reading.angular_velocity_mrad_s;
                *yaw_rate = yaw_rate.saturating_add(yaw_rate_mrad_s);
                let [forward, _, _] = &mut reading.linear_acceleration_mm_s2;
                *forward = forward.saturating_add(forward_mm_s2);
            }
            Self::Saturated => {
                reading.angular_velocity_mrad_s = [i16::MAX; 3];
                reading.linear_acceleration_mm_s2 = [i16::MIN; 3];
                reading.attitude_q14 = [i16::MAX; 4];
            }
            Self::Erratic => {
                if number % 2 == 1 {
                    let negative = i16::saturating_neg;
                    reading.angular_velocity_mrad_s = reading.angular_velocity_mrad_s.map(negative);
                    reading.linear_acceleration_mm_s2 =
                        reading.linear_acceleration_mm_s2.map(negative);
                }
            }
        }
        Some(reading)
    }
}

/// The sensor with its biases and drift.
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

    /// Constant bias plus random walk of the angular velocity, in rad/s.
    pub(crate) const fn gyro_bias(&self) -> [f64; 3] {
        self.gyro_bias
    }

    /// Takes a sample; call it once per period.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_silence_repeat_bias_saturate_or_reverse_the_samples() {
        let reading = |time_us, value| ImuReading {
            time_us,
            linear_acceleration_mm_s2: [value; 3],
            angular_velocity_mrad_s: [value; 3],
            attitude_q14: [16_384, 0, 0, 0],
        };
        let falsify =
            |fault: ImuFault, number| fault.falsify(reading(20, 5), Some(reading(10, 3)), number);
        assert_eq!(falsify(ImuFault::None, 1), Some(reading(20, 5)));
        assert_eq!(falsify(ImuFault::Silent, 1), None);
        assert_eq!(falsify(ImuFault::Stuck, 1), Some(reading(20, 3)));
        let biased = ImuFault::Biased {
            yaw_rate_mrad_s: 100,
            forward_mm_s2: i16::MAX,
        };
        let sample = falsify(biased, 1).unwrap();
        assert_eq!(sample.angular_velocity_mrad_s, [5, 5, 105]);
        assert_eq!(sample.linear_acceleration_mm_s2, [i16::MAX, 5, 5]);
        let saturated = falsify(ImuFault::Saturated, 1).unwrap();
        assert_eq!(saturated.angular_velocity_mrad_s, [i16::MAX; 3]);
        assert_eq!(falsify(ImuFault::Erratic, 2), Some(reading(20, 5)));
        let reversed = falsify(ImuFault::Erratic, 1).unwrap();
        assert_eq!(reversed.linear_acceleration_mm_s2, [-5; 3]);
    }
}
