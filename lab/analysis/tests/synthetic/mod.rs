//! A simulated car with a servo and noisy sensors. It shares only the vehicle model with the
//! code under test.

use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng, SeedableRng},
};
use singletrack_analysis::identification::{DriveData, Inertial, NoiseLevels, Pose, ServoTarget};
use singletrack_control::{RelaxedSingleTrack, SingleTrackState, VehicleParameters};

/// A drive: car, inputs and sensors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Course {
    pub(crate) vehicle: VehicleParameters,
    pub(crate) seconds: f64,
    /// Mean and amplitude of the speed of G, in m/s.
    pub(crate) speed: [f64; 2],
    /// Amplitude of the steering angle, in rad.
    pub(crate) steering: f64,
    pub(crate) servo_lag: f64,
    pub(crate) steering_delay: f64,
    pub(crate) steering_gain: f64,
    pub(crate) trim: f64,
    pub(crate) inertial_delay: f64,
    pub(crate) gyro_bias: f64,
    pub(crate) gyro_scale: f64,
    /// Time between inertial samples, in ms.
    pub(crate) inertial_period_ms: u64,
    pub(crate) forward_bias: f64,
    pub(crate) left_bias: f64,
    pub(crate) noise: NoiseLevels,
    pub(crate) seed: u64,
}

impl Course {
    /// Fast weaving, with the noise of good sensors.
    pub(crate) fn weaving(seed: u64, seconds: f64) -> Self {
        Self {
            vehicle: VehicleParameters::paper(),
            seconds,
            speed: [1.65, 0.15],
            steering: 0.22,
            servo_lag: 0.04,
            steering_delay: 0.003,
            steering_gain: 1.0,
            trim: 0.004,
            inertial_delay: 0.0015,
            gyro_bias: 0.006,
            gyro_scale: 1.0,
            inertial_period_ms: 10,
            forward_bias: -0.04,
            left_bias: 0.05,
            noise: NoiseLevels {
                position_m: 2e-4,
                yaw_rad: 1.7e-3,
                yaw_rate_rad_s: 3e-3,
                left_m_s2: 0.06,
                forward_density: 0.006,
                ..NoiseLevels::exact()
            },
            seed,
        }
    }

    /// Commanded steering angle at a time, in rad.
    fn commanded_angle(&self, time: f64) -> f64 {
        // Steps to both sides that never repeat.
        let one = (2.9 * time).sin();
        let other = (1.3 * time + 0.7).sin();
        let step = |x: f64| (8.0 * x).clamp(-1.0, 1.0);
        self.steering * (0.6 * step(one) + 0.4 * step(other))
    }

    fn speed_at(&self, time: f64) -> [f64; 2] {
        let [mean, amplitude] = self.speed;
        let rate = 0.9;
        [
            mean + amplitude * (rate * time).sin(),
            amplitude * rate * (rate * time).cos(),
        ]
    }

    /// The measured data.
    pub(crate) fn drive(&self) -> DriveData {
        const STEP: f64 = 0.001;
        let mut random = Noise(ChaCha8Rng::seed_from_u64(self.seed));
        let noise = &self.noise;
        let model = RelaxedSingleTrack::new(self.vehicle);
        let mut state = SingleTrackState::default();
        let mut steering = self.trim;
        let mut data = DriveData::default();
        let mut target = 0.0;
        // A sample is valid until the next.
        let valid_s = STEP * self.inertial_period_ms as f64;
        let ticks = (self.seconds / STEP).round() as u64;
        for tick in 0..=ticks {
            let time = tick as f64 * STEP;
            let [speed, along] = self.speed_at(time);
            if tick % 10 == 0 {
                data.servo.push(ServoTarget {
                    time_s: time,
                    period: tick / 10,
                    angle_rad: self.commanded_angle(time),
                });
            }
            // A pulse begins every 20 ms and takes effect after the delay.
            let delay = (self.steering_delay / STEP).round() as u64;
            if tick >= delay && (tick - delay).is_multiple_of(20) {
                target = self.commanded_angle((tick - delay) as f64 * STEP);
            }
            let rate = model.derivative(&state, speed, steering);
            let turning = speed * (rate.sideslip + state.yaw_rate);
            let (sin, cos) = state.sideslip.sin_cos();
            if tick % self.inertial_period_ms == 3 {
                data.inertial.push(Inertial {
                    time_s: time + self.inertial_delay,
                    yaw_rate_rad_s: self.gyro_scale * state.yaw_rate
                        + self.gyro_bias
                        + noise.yaw_rate_rad_s * random.normal(),
                    forward_m_s2: along * cos - turning * sin
                        + self.forward_bias
                        + noise.forward_density / valid_s.sqrt() * random.normal(),
                    left_m_s2: along * sin
                        + turning * cos
                        + self.left_bias
                        + noise.left_m_s2 * random.normal(),
                });
            }
            if tick % 10 == 7 {
                data.poses.push(Pose {
                    time_s: time,
                    x_m: state.x + noise.position_m * random.normal(),
                    y_m: state.y + noise.position_m * random.normal(),
                    yaw_rad: singletrack_control::wrap(state.yaw + noise.yaw_rad * random.normal()),
                });
            }
            (state, steering) = self.step(&model, &state, steering, target, time, STEP);
        }
        data
    }

    fn step(
        &self,
        model: &RelaxedSingleTrack,
        state: &SingleTrackState,
        steering: f64,
        target: f64,
        time: f64,
        h: f64,
    ) -> (SingleTrackState, f64) {
        let rest = self.steering_gain * target + self.trim;
        let rate = |s: &SingleTrackState, steering: f64, time: f64| {
            let turn = ((rest - steering) / self.servo_lag).clamp(-8.0, 8.0);
            (model.derivative(s, self.speed_at(time)[0], steering), turn)
        };
        let plus = |d: &(singletrack_control::SingleTrackDerivative, f64), h: f64| {
            let (d, turn) = d;
            (
                SingleTrackState {
                    x: state.x + h * d.x,
                    y: state.y + h * d.y,
                    yaw: state.yaw + h * d.yaw,
                    yaw_rate: state.yaw_rate + h * d.yaw_rate,
                    sideslip: state.sideslip + h * d.sideslip,
                },
                steering + h * turn,
            )
        };
        let k1 = rate(state, steering, time);
        let (s, d) = plus(&k1, h / 2.0);
        let k2 = rate(&s, d, time + h / 2.0);
        let (s, d) = plus(&k2, h / 2.0);
        let k3 = rate(&s, d, time + h / 2.0);
        let (s, d) = plus(&k3, h);
        let k4 = rate(&s, d, time + h);
        let mean = |f: fn(&singletrack_control::SingleTrackDerivative) -> f64| {
            (f(&k1.0) + 2.0 * f(&k2.0) + 2.0 * f(&k3.0) + f(&k4.0)) / 6.0
        };
        let turn = (k1.1 + 2.0 * k2.1 + 2.0 * k3.1 + k4.1) / 6.0;
        let d = singletrack_control::SingleTrackDerivative {
            x: mean(|d| d.x),
            y: mean(|d| d.y),
            yaw: mean(|d| d.yaw),
            yaw_rate: mean(|d| d.yaw_rate),
            sideslip: mean(|d| d.sideslip),
        };
        plus(&(d, turn), h)
    }
}

struct Noise(ChaCha8Rng);

impl Noise {
    fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Standard normal (Box and Muller).
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (core::f64::consts::TAU * self.uniform()).cos()
    }
}
