//! An extended Kalman filter of the car's planar motion.
//!
//! Strapdown navigation: gyro and accelerometers drive the prediction; poses and motor
//! speed correct it. The only vehicle parameter is the distance of the rear axle, so the
//! estimate is as robust as the law that uses it.

use libm::{hypot, sincos};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::{CarPose, EstimatorConfig};
use crate::{
    measurement::InertialSample,
    point::{Position, unwrap_near},
};

const STATES: usize = 9;
/// Position of G, world frame, m.
const X: usize = 0;
const Y: usize = 1;
/// Yaw, rad.
const YAW: usize = 2;
/// Velocity of G, world frame, m/s.
const VX: usize = 3;
const VY: usize = 4;
/// Gyro bias, rad/s.
const GYRO_BIAS: usize = 5;
/// Accelerometer biases, car's axes, m/s².
const FORWARD_BIAS: usize = 6;
const LEFT_BIAS: usize = 7;
/// What the gyro reads of a yaw rate beyond it, as a fraction.
const GYRO_SCALE: usize = 8;

type StateVector = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;

/// Mean and covariance. The caller keeps their time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Filter {
    mean: StateVector,
    covariance: Covariance,
    /// The normalised innovation squared of the last poses, as a running mean.
    usual: f64,
}

/// The navigation state of a filter's mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Navigation {
    pub(super) position: Position,
    pub(super) yaw: f64,
    pub(super) yaw_rate: f64,
    /// Velocity of G in the car's axes, m/s.
    pub(super) forward: f64,
    pub(super) left: f64,
}

impl Filter {
    /// The estimated gyro bias, rad/s.
    pub(super) fn gyro_bias(&self) -> f64 {
        self.mean[GYRO_BIAS]
    }

    /// The estimated scale of the gyro: what it reads of a yaw rate.
    pub(super) fn gyro_scale(&self) -> f64 {
        1.0 + self.mean[GYRO_SCALE]
    }

    /// The yaw rate of a sample without bias and scale, rad/s.
    fn yaw_rate(&self, inertial: &InertialSample) -> f64 {
        (inertial.yaw_rate - self.mean[GYRO_BIAS]) / self.gyro_scale()
    }

    /// A filter that starts at a pose, with zero velocity and biases.
    pub(super) fn at_pose(pose: &CarPose, config: &EstimatorConfig) -> Self {
        let mut mean = StateVector::zeros();
        mean[X] = pose.position.x;
        mean[Y] = pose.position.y;
        mean[YAW] = pose.yaw;
        let mut variances = StateVector::zeros();
        variances[X] = square(config.position_noise);
        variances[Y] = square(config.position_noise);
        variances[YAW] = square(config.yaw_noise);
        variances[VX] = square(INITIAL_VELOCITY_DEVIATION);
        variances[VY] = square(INITIAL_VELOCITY_DEVIATION);
        variances[GYRO_BIAS] = square(INITIAL_GYRO_BIAS_DEVIATION);
        variances[FORWARD_BIAS] = square(INITIAL_ACCELERATION_BIAS_DEVIATION);
        variances[LEFT_BIAS] = square(INITIAL_ACCELERATION_BIAS_DEVIATION);
        variances[GYRO_SCALE] = square(config.gyro_scale_noise);
        Self {
            mean,
            covariance: Covariance::from_diagonal(&variances),
            usual: CONSISTENT,
        }
    }

    /// Predicts mean and covariance over `dt` seconds with a constant inertial sample.
    pub(super) fn predict(&mut self, dt: f64, inertial: &InertialSample, config: &EstimatorConfig) {
        let (forward, left) = (
            inertial.forward_acceleration - self.mean[FORWARD_BIAS],
            inertial.left_acceleration - self.mean[LEFT_BIAS],
        );
        let (yaw_rate, scale) = (self.yaw_rate(inertial), self.gyro_scale());
        let heading = self.predict_mean(dt, inertial);
        let (s, c) = sincos(heading);
        let half = 0.5 * dt * dt;

        // Jacobian of the mean's propagation.
        let mut jacobian = Covariance::identity();
        jacobian[(X, VX)] = dt;
        jacobian[(Y, VY)] = dt;
        jacobian[(YAW, GYRO_BIAS)] = -dt / scale;
        jacobian[(YAW, GYRO_SCALE)] = -yaw_rate * dt / scale;
        let across = (-s * forward - c * left, c * forward - s * left);
        for (row, position_row, d_yaw, d_forward, d_left) in
            [(VX, X, across.0, -c, s), (VY, Y, across.1, -s, -c)]
        {
            jacobian[(row, YAW)] = d_yaw * dt;
            jacobian[(row, FORWARD_BIAS)] = d_forward * dt;
            jacobian[(row, LEFT_BIAS)] = d_left * dt;
            jacobian[(position_row, YAW)] = d_yaw * half;
            jacobian[(position_row, FORWARD_BIAS)] = d_forward * half;
            jacobian[(position_row, LEFT_BIAS)] = d_left * half;
        }
        self.covariance = jacobian * self.covariance * jacobian.transpose();

        let squared_speed = square(self.mean[VX]) + square(self.mean[VY]);
        let acceleration = config.acceleration_variance(squared_speed) * dt;
        for (velocity, position) in [(VX, X), (VY, Y)] {
            self.covariance[(velocity, velocity)] += acceleration;
            self.covariance[(position, position)] += acceleration * dt * dt / 3.0;
            self.covariance[(velocity, position)] += acceleration * dt / 2.0;
            self.covariance[(position, velocity)] += acceleration * dt / 2.0;
        }
        self.covariance[(YAW, YAW)] += square(config.gyro_noise_density) * dt;
        self.covariance[(GYRO_BIAS, GYRO_BIAS)] += square(config.gyro_bias_walk) * dt;
        for bias in [FORWARD_BIAS, LEFT_BIAS] {
            self.covariance[(bias, bias)] += square(config.acceleration_bias_walk) * dt;
        }
    }

    /// Predicts the mean only, over `dt` seconds. Returns the yaw at half of them, rad.
    pub(super) fn predict_mean(&mut self, dt: f64, inertial: &InertialSample) -> f64 {
        let yaw_rate = self.yaw_rate(inertial);
        let heading = self.mean[YAW] + 0.5 * yaw_rate * dt;
        let (s, c) = sincos(heading);
        let forward = inertial.forward_acceleration - self.mean[FORWARD_BIAS];
        let left = inertial.left_acceleration - self.mean[LEFT_BIAS];
        let (ax, ay) = (c * forward - s * left, s * forward + c * left);
        self.mean[X] += dt * (self.mean[VX] + 0.5 * ax * dt);
        self.mean[Y] += dt * (self.mean[VY] + 0.5 * ay * dt);
        self.mean[VX] += ax * dt;
        self.mean[VY] += ay * dt;
        self.mean[YAW] += yaw_rate * dt;
        heading
    }

    /// The estimated biases of the accelerometer, forward and left, m/s².
    pub(super) fn acceleration_bias(&self) -> [f64; 2] {
        [self.mean[FORWARD_BIAS], self.mean[LEFT_BIAS]]
    }

    /// The variance of the velocity across the car, m²/s²: of the velocity, and of the yaw by
    /// which it is across.
    pub(super) fn left_variance(&self) -> f64 {
        let (s, c) = sincos(self.mean[YAW]);
        let mut row = StateVector::zeros();
        row[VX] = -s;
        row[VY] = c;
        row[YAW] = -c * self.mean[VX] - s * self.mean[VY];
        row.dot(&(self.covariance * row))
    }

    /// Corrects with a pose. Returns its normalised innovation squared (3 degrees of freedom),
    /// and whether it was within the gate; otherwise nothing changes.
    ///
    /// A pose that stands out of the last ones counts the less the farther it is off: it counts as
    /// one whose noise is as much larger. Where all of them are off, it is the estimate that is
    /// wrong, and they count in full.
    pub(super) fn correct_pose(&mut self, pose: &CarPose, config: &EstimatorConfig) -> (f64, bool) {
        let innovation = Vector3::new(
            pose.position.x - self.mean[X],
            pose.position.y - self.mean[Y],
            unwrap_near(pose.yaw, self.mean[YAW]) - self.mean[YAW],
        );
        let noise = Vector3::new(
            square(config.position_noise),
            square(config.position_noise),
            square(config.yaw_noise),
        );
        let predicted: Matrix3<f64> = self.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let spread = predicted + Matrix3::from_diagonal(&noise);
        let Some(inverse) = spread.try_inverse() else {
            return (f64::INFINITY, false);
        };
        let normalised = innovation.dot(&(inverse * innovation));
        // What the model lacks widens the gate, not the noise.
        let lacking = Vector3::new(config.position_gate, config.position_gate, config.yaw_gate);
        let widened = spread + Matrix3::from_diagonal(&(lacking / GATE_DEVIATIONS).map(square));
        let within = widened.try_inverse().is_some_and(|inverse| {
            // A NaN is outside.
            innovation.dot(&(inverse * innovation)) <= square(GATE_DEVIATIONS)
        });
        if !within {
            return (normalised, false);
        }
        let outlier = OUTLIER * (self.usual / CONSISTENT).max(1.0);
        self.usual += SHARE * (normalised.min(MOST * outlier) - self.usual);
        let inverse = inverse / (normalised / outlier).max(1.0);
        let gain = self.covariance.fixed_columns::<3>(0) * inverse;
        self.mean += gain * innovation;
        self.covariance -= gain * self.covariance.fixed_rows::<3>(0).into_owned();
        self.settle();
        (normalised, true)
    }

    /// Corrects with the speed from the motor pulses (m/s), if it is measured, and with a lateral
    /// speed of the rear axle of zero: its wheels roll along the car.
    pub(super) fn correct_wheels(
        &mut self,
        motor_speed: Option<f64>,
        inertial: &InertialSample,
        config: &EstimatorConfig,
    ) {
        if let Some(motor_speed) = motor_speed {
            let (s, c) = sincos(self.mean[YAW]);
            let (vx, vy) = (self.mean[VX], self.mean[VY]);
            let mut row = StateVector::zeros();
            row[VX] = c;
            row[VY] = s;
            row[YAW] = -s * vx + c * vy;
            let innovation = motor_speed - (c * vx + s * vy);
            let noise =
                config.motor_speed_noise + config.motor_speed_scale_noise * motor_speed.abs();
            self.correct_scalar(&row, innovation, noise);
        }

        let (s, c) = sincos(self.mean[YAW]);
        let (vx, vy) = (self.mean[VX], self.mean[VY]);
        let l_r = config.rear_axle_distance;
        let mut row = StateVector::zeros();
        row[VX] = -s;
        row[VY] = c;
        row[YAW] = -c * vx - s * vy;
        let (yaw_rate, scale) = (self.yaw_rate(inertial), self.gyro_scale());
        row[GYRO_BIAS] = l_r / scale;
        row[GYRO_SCALE] = l_r * yaw_rate / scale;
        let innovation = -((-s * vx + c * vy) - l_r * yaw_rate);
        // The tyres slip by an angle in proportion to the lateral acceleration v r.
        let forward = c * vx + s * vy;
        let slip = config.rear_slip_compliance * square(forward) * yaw_rate;
        let noise = hypot(config.rear_slip_noise, slip);
        self.correct_scalar(&row, innovation, noise);
    }

    fn correct_scalar(&mut self, row: &StateVector, innovation: f64, deviation: f64) {
        let projected = self.covariance * row;
        let spread = row.dot(&projected) + square(deviation);
        // Wheels that spin, and tyres that slide, count the less the farther they are off.
        let excess = square(innovation) / spread / SLIDING;
        let gain = projected / (spread * excess.max(1.0));
        self.mean += gain * innovation;
        self.covariance -= gain * projected.transpose();
        self.settle();
    }

    /// Keeps the covariance symmetric, and the gyro's scale in its bounds.
    fn settle(&mut self) {
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose());
        let scale = &mut self.mean[GYRO_SCALE];
        *scale = scale.clamp(-GYRO_SCALE_BOUND, GYRO_SCALE_BOUND);
    }

    /// Whether mean and covariance are finite.
    pub(super) fn is_finite(&self) -> bool {
        self.mean.iter().all(|value| value.is_finite())
            && self.covariance.iter().all(|value| value.is_finite())
    }

    pub(super) fn navigation(&self, inertial: &InertialSample) -> Navigation {
        let (s, c) = sincos(self.mean[YAW]);
        let (vx, vy) = (self.mean[VX], self.mean[VY]);
        Navigation {
            position: Position::new(self.mean[X], self.mean[Y]),
            yaw: self.mean[YAW],
            yaw_rate: self.yaw_rate(inertial),
            forward: c * vx + s * vy,
            left: -s * vx + c * vy,
        }
    }
}

/// The car may already roll at its first pose, m/s.
const INITIAL_VELOCITY_DEVIATION: f64 = 0.5;
/// Typical of consumer gyros at start, rad/s.
const INITIAL_GYRO_BIAS_DEVIATION: f64 = 0.05;
/// Typical of consumer accelerometers, and of a floor that is not level, m/s².
const INITIAL_ACCELERATION_BIAS_DEVIATION: f64 = 0.3;
/// The innovation gate, in standard deviations.
const GATE_DEVIATIONS: f64 = 5.0;
/// The mean of the normalised innovation squared of a consistent estimate: its degrees of freedom.
const CONSISTENT: f64 = 3.0;
/// The normalised innovation squared from which a pose of a consistent estimate is an outlier: one
/// of 65,000.
const OUTLIER: f64 = 25.0;
/// The share of a pose in what is usual: the last ten count...
const SHARE: f64 = 0.1;
/// ...and an outlier at most as this multiple of the outlier limit: with each outlier in a row what is
/// usual grows by a third, so that a jump of the cameras is believed after some twenty, not three.
const MOST: f64 = 0.5;
/// The normalised innovation squared from which motor speed and rear axle are outliers, with one
/// degree of freedom: three deviations.
const SLIDING: f64 = 9.0;
/// The largest error of the gyro's scale: no gyro that works is farther off.
const GYRO_SCALE_BOUND: f64 = 0.1;

fn square(value: f64) -> f64 {
    value * value
}
