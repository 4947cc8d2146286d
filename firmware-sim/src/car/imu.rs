//! The inertial measurement unit, modelled on the BNO055 in its fusion mode without
//! magnetometer.

use singletrack_control::GRAVITY;
use singletrack_settings::section;
use singletrack_simavr::{ImuRegisters, Motion};

use super::Truth;
use crate::{
    car::Rotation,
    random::{Random, Stream},
    ranges::{FINITE, NOT_NEGATIVE, PERIOD, POSITIVE, PROBABILITY},
};

section! {
    /// The IMU's rate, noise, biases and mounting. It sits at the centre of mass, with its
    /// axes forward, left, up unless it is turned.
    ///
    /// The vibration by default is that of a real small car, rounded, from its logs:
    /// `docs/real-logs.md` and `tools/vehicles/dart-truth.toml`.
    "car.imu" => pub ImuParameters: Copy;
    [default];

    /// Time between samples, in µs.
    period_us: u64 = 10_000, in PERIOD;
    /// Time of the first sample, in µs.
    phase_us: u64 = 3_700;
    /// Time from the measurement to the arrival at the board, in µs.
    latency_us: u64 = 1_200;
    /// Standard deviation of the angular velocity, in rad/s.
    gyro_noise_rad_s: f64 = 0.003;
    /// Standard deviation of the constant bias of the angular velocity, in rad/s.
    gyro_bias_rad_s: f64 = 0.005;
    /// Random walk of the bias, in rad/s per square root of a second.
    gyro_walk_rad_s: f64 = 0.000_1;
    /// Standard deviation of the linear acceleration, in m/s².
    acceleration_noise_m_s2: f64 = 0.06;
    /// Standard deviation of the constant bias of the acceleration, in m/s².
    acceleration_bias_m_s2: f64 = 0.05;
    /// Standard deviation of roll, pitch and yaw, in rad.
    attitude_noise_rad: f64 = 0.001;
    /// Random walk of the yaw, in rad per square root of a second.
    yaw_walk_rad: f64 = 0.001;
    /// How the sensor is turned on the car, in degrees: first by the last angle about the
    /// car's up axis, then by the second about its new left axis, then by the first about
    /// its new forward axis. Samples are along the sensor's own axes.
    mounting_deg: [f64; 3] = [0.0; 3], in FINITE;
    /// Measured over true angular velocity.
    gyro_scale: f64 = 1.0, in FINITE;
    /// Measured over true acceleration.
    acceleration_scale: f64 = 1.0, in FINITE;
    /// Standard deviation of the acceleration by vibration while the wheels turn, in m/s².
    vibration_m_s2: f64 = 0.8, in NOT_NEGATIVE;
    /// Standard deviation of the angular velocity by vibration while the wheels turn, in
    /// rad/s.
    vibration_rad_s: f64 = 0.05, in NOT_NEGATIVE;
    /// What each m/s of the wheels' speed adds to the deviation of the acceleration, in 1/s.
    vibration_m_s2_per_m_s: f64 = 0.8, in NOT_NEGATIVE;
    /// What it adds to that of the angular velocity, in rad/m.
    vibration_rad_s_per_m_s: f64 = 0.016, in NOT_NEGATIVE;
    /// Time constant with which a lasting acceleration is taken for gravity, in s: it
    /// leaks out of the linear acceleration, and tilts the attitude. Never if left out.
    leak_s: Option<f64> = None, in POSITIVE;
    /// Probability that a sample is torn: the low bytes are those of the last one.
    torn: f64 = 0.0, in PROBABILITY;
    /// Calibration of system, gyroscope and accelerometer, 0 (none) to 3 (full).
    calibration: [u8; 3] = [3; 3], in in_words("0 to 3", |x| x <= 3.0);
    /// Register `SYS_STATUS`: 5 while the fusion runs.
    system_status: u8 = 5;
    /// Register `SYS_ERR`: 0 without error.
    system_error: u8 = 0;
    /// Register `ST_RESULT`: 15 if all self-tests passed.
    self_test: u8 = 15;
    /// Time from the return of the supply to the first sample, in ms.
    restart_ms: f64 = 650.0, in NOT_NEGATIVE;
}

impl ImuParameters {
    /// This sensor on a car that does not vibrate.
    #[must_use]
    pub const fn without_vibration(mut self) -> Self {
        self.vibration_m_s2 = 0.0;
        self.vibration_rad_s = 0.0;
        self.vibration_m_s2_per_m_s = 0.0;
        self.vibration_rad_s_per_m_s = 0.0;
        self
    }

    /// The registers of its health.
    pub const fn registers(&self) -> ImuRegisters {
        let [system, gyroscope, accelerometer] = self.calibration;
        ImuRegisters {
            calibration: (system & 3) << 6 | (gyroscope & 3) << 4 | (accelerometer & 3) << 2,
            self_test: self.self_test,
            status: self.system_status,
            error: self.system_error,
        }
    }
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
    /// Single samples get a wrong bit on the bus, which has no checksum: one of
    /// the two highest of the angular velocities or of the quaternion.
    WrongBit {
        /// From one such sample to the next.
        every: u16,
    },
}

impl ImuFault {
    /// The sample that the board gets for `reading`; `last` is the previous one.
    pub(crate) fn falsify(
        self,
        mut reading: Motion,
        last: Option<Motion>,
        number: u64,
    ) -> Option<Motion> {
        match self {
            Self::Silent => return None,
            Self::Stuck => reading = last.unwrap_or(reading),
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
            Self::Erratic if number % 2 == 1 => {
                let negative = |values: [i16; 3]| values.map(i16::saturating_neg);
                reading.angular_velocity_mrad_s = negative(reading.angular_velocity_mrad_s);
                reading.linear_acceleration_mm_s2 = negative(reading.linear_acceleration_mm_s2);
            }
            Self::None | Self::Erratic => {}
            Self::WrongBit { every } => {
                let every = u64::from(every.max(1));
                if number.is_multiple_of(every) {
                    let turn = number / every;
                    // Two of three are the yaw rate.
                    let (is_odd, is_attitude) = (turn % 2 == 1, turn.is_multiple_of(3));
                    let bit = if is_odd { 1 << 14 } else { i16::MIN };
                    let place = if is_attitude { turn / 3 % 4 } else { 4 };
                    let [_, _, yaw_rate] = &mut reading.angular_velocity_mrad_s;
                    let words = reading.attitude_q14.iter_mut().chain([yaw_rate]);
                    if let Some(word) = words.zip(0..).find(|(_, at)| *at == place) {
                        *word.0 ^= bit;
                    }
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
    /// Constant bias plus random walk of the angular velocity, in rad/s.
    pub(crate) gyro_bias: [f64; 3],
    acceleration_bias: [f64; 3],
    yaw_drift: f64,
    mounting: Option<Rotation>,
    vibration_random: Random,
    torn_random: Random,
    /// Acceleration taken for gravity, forward and left, in m/s².
    leaked: [f64; 2],
    last: Option<Motion>,
}

/// Wheels slower than this do not make the sensor vibrate, in m/s.
const VIBRATING: f64 = 0.02;

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
            mounting: Rotation::from_degrees(parameters.mounting_deg),
            vibration_random: Random::new(seed, Stream::Vibration),
            torn_random: Random::new(seed, Stream::TornSamples),
            leaked: [0.0; 2],
            last: None,
        }
    }

    /// Restarts the sensor: gravity is found again.
    pub(crate) const fn restart(&mut self) {
        self.leaked = [0.0; 2];
        self.last = None;
    }

    /// Takes a sample; call it once per period.
    pub(crate) fn sample(&mut self, truth: &Truth) -> Motion {
        let p = &self.parameters;
        let root_period = libm::sqrt(p.period_us as f64 * 1e-6);
        let walk = self.gyro_random.normal3(p.gyro_walk_rad_s * root_period);
        let gyro_noise = self.gyro_random.normal3(p.gyro_noise_rad_s);
        let acceleration_noise = self.acceleration_random.normal3(p.acceleration_noise_m_s2);
        self.yaw_drift += self.attitude_random.normal() * p.yaw_walk_rad * root_period;
        let tilt = self.attitude_random.normal3(p.attitude_noise_rad);

        let mut rate = [truth.roll_rate, truth.pitch_rate, truth.yaw_rate];
        let (along, across) = (truth.longitudinal_acceleration, truth.lateral_acceleration);
        let mut acceleration = [along, across, 0.0];
        let [mut roll, mut pitch] = [truth.roll, truth.pitch];
        if let Some(leak_s) = p.leak_s {
            let share = 1.0 - libm::exp(-(p.period_us as f64) * 1e-6 / leak_s);
            for (acceleration, leaked) in acceleration.iter_mut().zip(&mut self.leaked) {
                *leaked += share * (*acceleration - *leaked);
                *acceleration -= *leaked;
            }
            // Where gravity is believed to be.
            let [forward, left] = self.leaked;
            pitch -= libm::atan2(forward, GRAVITY);
            roll += libm::atan2(left, GRAVITY);
        }
        let speed = truth.wheel_speed.abs();
        if speed > VIBRATING {
            let mut vibrate = |deviation: f64, values: &mut [f64; 3]| {
                if deviation > 0.0 {
                    let vibration = self.vibration_random.normal3(deviation);
                    for (value, vibration) in values.iter_mut().zip(vibration) {
                        *value += vibration;
                    }
                }
            };
            let deviation = p.vibration_rad_s + p.vibration_rad_s_per_m_s * speed;
            vibrate(deviation, &mut rate);
            let deviation = p.vibration_m_s2 + p.vibration_m_s2_per_m_s * speed;
            vibrate(deviation, &mut acceleration);
        }
        rate = rate.map(|rate| rate * p.gyro_scale);
        acceleration = acceleration.map(|acceleration| acceleration * p.acceleration_scale);
        let yaw = truth.yaw + self.yaw_drift + tilt[2];
        let mut attitude = super::quaternion_wxyz(yaw, tilt[0] + roll, tilt[1] + pitch);
        if let Some(mounting) = &self.mounting {
            rate = mounting.into_turned(rate);
            acceleration = mounting.into_turned(acceleration);
            attitude = mounting.after(attitude);
        }
        for (bias, walk) in self.gyro_bias.iter_mut().zip(walk) {
            *bias += walk;
        }
        let quantised = |values: [f64; 3], bias: [f64; 3], noise: [f64; 3]| {
            core::array::from_fn(|axis| quantise((values[axis] + bias[axis] + noise[axis]) * 1e3))
        };
        let bias = self.acceleration_bias;
        let mut reading = Motion {
            linear_acceleration_mm_s2: quantised(acceleration, bias, acceleration_noise),
            angular_velocity_mrad_s: quantised(rate, self.gyro_bias, gyro_noise),
            attitude_q14: attitude.map(|component| quantise(component * 16384.0)),
        };
        let whole = reading;
        if let (true, Some(last)) = (p.torn > 0.0 && self.torn_random.happens(p.torn), self.last) {
            let (rate, acceleration) = (
                &mut reading.angular_velocity_mrad_s,
                &mut reading.linear_acceleration_mm_s2,
            );
            tear(rate, last.angular_velocity_mrad_s);
            tear(acceleration, last.linear_acceleration_mm_s2);
        }
        self.last = Some(whole);
        reading
    }
}

/// Takes the low bytes from the sample before.
fn tear(values: &mut [i16; 3], before: [i16; 3]) {
    for (value, before) in values.iter_mut().zip(before) {
        let [low, _] = before.to_le_bytes();
        let [_, high] = value.to_le_bytes();
        *value = i16::from_le_bytes([low, high]);
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
        let reading = |value| Motion {
            linear_acceleration_mm_s2: [value; 3],
            angular_velocity_mrad_s: [value; 3],
            attitude_q14: [16_384, 0, 0, 0],
        };
        let falsify = |fault: ImuFault, number| fault.falsify(reading(5), Some(reading(3)), number);
        assert_eq!(falsify(ImuFault::None, 1), Some(reading(5)));
        assert_eq!(falsify(ImuFault::Silent, 1), None);
        assert_eq!(falsify(ImuFault::Stuck, 1), Some(reading(3)));
        let biased = ImuFault::Biased {
            yaw_rate_mrad_s: 100,
            forward_mm_s2: i16::MAX,
        };
        let sample = falsify(biased, 1).unwrap();
        assert_eq!(sample.angular_velocity_mrad_s, [5, 5, 105]);
        assert_eq!(sample.linear_acceleration_mm_s2, [i16::MAX, 5, 5]);
        let saturated = falsify(ImuFault::Saturated, 1).unwrap();
        assert_eq!(saturated.angular_velocity_mrad_s, [i16::MAX; 3]);
        assert_eq!(falsify(ImuFault::Erratic, 2), Some(reading(5)));
        let reversed = falsify(ImuFault::Erratic, 1).unwrap();
        assert_eq!(reversed.linear_acceleration_mm_s2, [-5; 3]);
        let wrong = |number| falsify(ImuFault::WrongBit { every: 100 }, number).unwrap();
        assert_eq!(wrong(199), reading(5));
        assert_eq!(wrong(100).angular_velocity_mrad_s, [5, 5, 5 + (1 << 14)]);
        assert_eq!(wrong(200).angular_velocity_mrad_s, [5, 5, 5 + i16::MIN]);
        assert_eq!(wrong(300).attitude_q14, [16_384, 1 << 14, 0, 0]);
    }

    /// A sensor without noise, and its readings of a constant motion.
    fn readings(change: impl FnOnce(&mut ImuParameters), truth: Truth, n: usize) -> Vec<Motion> {
        let mut parameters = ImuParameters {
            gyro_noise_rad_s: 0.0,
            gyro_bias_rad_s: 0.0,
            gyro_walk_rad_s: 0.0,
            acceleration_noise_m_s2: 0.0,
            acceleration_bias_m_s2: 0.0,
            attitude_noise_rad: 0.0,
            yaw_walk_rad: 0.0,
            ..ImuParameters::default().without_vibration()
        };
        change(&mut parameters);
        let mut imu = Imu::new(parameters, 1);
        (0..n).map(|_| imu.sample(&truth)).collect()
    }

    /// Turning left at 0.5 rad/s while accelerating forward with 1 m/s².
    fn turning() -> Truth {
        Truth {
            yaw_rate: 0.5,
            longitudinal_acceleration: 1.0,
            lateral_acceleration: 0.2,
            wheel_speed: 0.4,
            ..Truth::default()
        }
    }

    fn mounted(mounting_deg: [f64; 3]) -> Motion {
        readings(|p| p.mounting_deg = mounting_deg, turning(), 1)[0]
    }

    #[test]
    fn a_turned_sensor_measures_along_its_own_axes() {
        let straight = mounted([0.0; 3]);
        assert_eq!(straight.linear_acceleration_mm_s2, [1000, 200, 0]);
        // Its forward axis points left.
        let left = mounted([0.0, 0.0, 90.0]);
        assert_eq!(left.linear_acceleration_mm_s2, [200, -1000, 0]);
        assert_eq!(left.angular_velocity_mrad_s, [0, 0, 500]);
        let half = 11_585; // sin and cos of 45 degrees
        assert_eq!(left.attitude_q14, [half, 0, 0, half]);
        // Upside down, rolled over its forward axis.
        let upside_down = mounted([180.0, 0.0, 0.0]);
        assert_eq!(upside_down.linear_acceleration_mm_s2, [1000, -200, 0]);
        assert_eq!(upside_down.angular_velocity_mrad_s, [0, 0, -500]);
        // Nose down: its forward axis points down, its up axis forward.
        let nose_down = mounted([0.0, 90.0, 0.0]);
        assert_eq!(nose_down.linear_acceleration_mm_s2, [0, 200, 1000]);
        assert_eq!(nose_down.angular_velocity_mrad_s, [-500, 0, 0]);
    }

    #[test]
    fn a_lasting_acceleration_leaks_away_and_tilts_the_attitude() {
        // Ten time constants.
        let last = *readings(|p| p.leak_s = Some(2.0), turning(), 2_000)
            .last()
            .unwrap();
        assert_eq!(last.linear_acceleration_mm_s2, [0, 0, 0]);
        assert_eq!(last.angular_velocity_mrad_s, [0, 0, 500]);
        // Half the tilt's angle, over 9.81 m/s²: left side up, nose up.
        let [_, roll, pitch, _] = last.attitude_q14;
        assert!((f64::from(roll) / 16_384.0 - 0.2 / 9.81 / 2.0).abs() < 2e-4);
        assert!((f64::from(pitch) / 16_384.0 + 1.0 / 9.81 / 2.0).abs() < 5e-4);
        let first = readings(|p| p.leak_s = Some(2.0), turning(), 1)[0];
        assert!(first.linear_acceleration_mm_s2[0] > 990);
    }

    #[test]
    fn scale_and_vibration_change_the_samples_of_a_moving_car() {
        let scaled = readings(
            |p| (p.gyro_scale, p.acceleration_scale) = (1.1, 0.5),
            turning(),
            1,
        )[0];
        assert_eq!(scaled.angular_velocity_mrad_s, [0, 0, 550]);
        assert_eq!(scaled.linear_acceleration_mm_s2, [500, 100, 0]);
        let deviation = |truth: Truth, per_speed: f64| {
            let vibrating = |p: &mut ImuParameters| {
                (p.vibration_m_s2, p.vibration_m_s2_per_m_s) = (2.0, per_speed);
            };
            let readings = readings(vibrating, truth, 2_000);
            let up = readings
                .iter()
                .map(|reading| f64::from(reading.linear_acceleration_mm_s2[2]).powi(2));
            (up.sum::<f64>() / 2_000.0).sqrt()
        };
        assert!((deviation(turning(), 0.0) - 2_000.0).abs() < 150.0);
        let faster = 2_000.0 + 3_000.0 * turning().wheel_speed;
        assert!((deviation(turning(), 3.0) / faster - 1.0).abs() < 0.075);
        assert_eq!(deviation(Truth::default(), 3.0), 0.0);
    }

    #[test]
    fn a_torn_sample_has_the_low_bytes_of_the_last_one() {
        let mut values = [0x0123, -1, 256];
        tear(&mut values, [0x0456, 0, 255]);
        assert_eq!(values, [0x0156, -256, 511]);
    }

    #[test]
    fn the_registers_are_those_of_the_data_sheet() {
        let mut p = ImuParameters::default();
        let good = ImuRegisters {
            calibration: 0b1111_1100,
            self_test: 15,
            status: 5,
            error: 0,
        };
        assert_eq!(p.registers(), good);
        p.calibration = [0, 3, 1];
        assert_eq!(p.registers().calibration, 0b0011_0100);
    }
}
