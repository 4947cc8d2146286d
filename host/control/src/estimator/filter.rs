//! One extended Kalman filter of the car's planar motion.
//!
//! The motion is that of a rigid body whose rear axle slips little: the velocity of G in the car's
//! axes is `(u, s + (l_r - c u²) r)`, with the speed u, the slip s of the rear axle, the yaw rate r and
//! the compliance c of its tyres. What the steering that was sent says of the yaw rate is a prior:
//! r = u (1 + g) tan δ/L + u θ/L + d, with the wheelbase L, the gain g and the trim θ of the steering, and the
//! discrepancy d, which takes up all that is wrong with it. No mass, inertia or tyre stiffness is in it.
//! Poses, gyro and motor pulses are measurements. A filter [without steering](Prior::steering) has r = d.

use libm::{exp, fabs, log, sincos};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::{CarPose, EstimatorConfig};
use crate::measurement::unwrap_near;

/// Position of G, world frame, m.
const X: usize = 0;
const Y: usize = 1;
/// Yaw, rad.
const YAW: usize = 2;
/// Forward speed of G, m/s.
const SPEED: usize = 3;
/// Its change, m/s².
const ACCELERATION: usize = 4;
/// Speed of the rear axle to the left, beyond that of a compliant tyre, m/s.
const SLIP: usize = 5;
/// What the steering does not say of the yaw rate, rad/s.
const TURN: usize = 6;
/// Its change without steering, rad/s².
const TURN_CHANGE: usize = 7;
/// The states before this one move; the others are constants, or walk.
const MOVING: usize = 8;
/// Gyro bias, rad/s.
const GYRO_BIAS: usize = 8;
/// What the gyro reads of a yaw rate beyond it, as a fraction.
const GYRO_SCALE: usize = 9;
/// What the motor's sensor reads of a speed beyond it, as a fraction.
const MOTOR_SCALE: usize = 10;
/// Tangent of the front wheels' angle beyond that of the one sent, as a fraction.
const STEERING_GAIN: usize = 11;
/// Tangent of the front wheels' angle when straight ones are sent.
const STEERING_TRIM: usize = 12;
/// Angle at which the rear tyres slip per lateral acceleration, over the speed: s²/m.
const COMPLIANCE: usize = 13;
/// Bias of the forward accelerometer, m/s².
const FORWARD_BIAS: usize = 14;
const STATES: usize = 15;
const FIXED: usize = STATES - MOVING;

type StateVector = SVector<f64, STATES>;
type Covariance = SMatrix<f64, STATES, STATES>;

/// What a filter believes of how the yaw rate and the slip of the rear axle change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Prior {
    /// Whether the steering that was sent says anything of the yaw rate.
    pub(super) steering: bool,
    /// Noise of the discrepancy, rad/s/√s: always, per yaw rate, and per change of the yaw rate that
    /// the steering commands: lag and play that are not known count while it moves.
    pub(super) turn: [f64; 3],
    /// Noise of the rear axle's slip, m/s/√s: always, and per speed and lateral acceleration.
    pub(super) slip: [f64; 2],
    /// Standard deviation of the forward acceleration, m/s².
    pub(super) forward: f64,
}

/// Without steering, the standard deviation of the yaw acceleration, rad/s², and its time constant, s.
const YAW_ACCELERATION: [f64; 2] = [5.0, 0.15];
/// Time constants of the discrepancy and of the slip, s.
const TURN_TIME: f64 = 3.0;
const SLIP_TIME: f64 = 0.5;
/// Time constant of the forward acceleration, s.
const FORWARD_TIME: f64 = 0.2;

/// Standard deviations at the first pose. The car may already roll, m/s...
const INITIAL_SPEED: f64 = 0.5;
/// ...and turn, rad/s, with and without steering.
const INITIAL_TURN: [f64; 2] = [0.1, 0.5];
/// Typical of consumer gyros at start, rad/s.
const INITIAL_GYRO_BIAS: f64 = 0.05;
const INITIAL_SLIP: f64 = 0.05;
const INITIAL_MOTOR_SCALE: f64 = 0.05;
const INITIAL_STEERING_GAIN: f64 = 0.1;
const INITIAL_STEERING_TRIM: f64 = 0.03;
const INITIAL_COMPLIANCE: f64 = 0.01;
/// Typical of consumer accelerometers, and of a floor that is not level, m/s².
const INITIAL_FORWARD_BIAS: f64 = 0.3;

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
/// The normalised innovations squared from which gyro and motor speed are outliers: four deviations
/// and three. Wheels that spin count the less the farther they are off.
const GYRO_OUTLIER: f64 = 16.0;
const MOTOR_OUTLIER: f64 = 9.0;
/// What a refused pose, and at most an accepted one, counts against a filter.
const REFUSED: f64 = 60.0;
const LEAST_LIKELY: f64 = 30.0;
/// The largest errors of the scales: no sensor that works is farther off.
const SCALE_BOUND: f64 = 0.1;

/// Mean and covariance, and how likely its measurements were. The caller keeps their time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Filter {
    prior: Prior,
    mean: StateVector,
    covariance: Covariance,
    /// The normalised innovation squared of the last poses, as a running mean.
    usual: f64,
    /// The innovation of the last accepted pose...
    before: Vector3<f64>,
    /// ...and its normalised product with the one before, as a running mean. It is 0 of a consistent
    /// estimate.
    persistent: f64,
    /// The logarithm of the likelihood of all measurements since the caller took it.
    pub(super) likelihood: f64,
}

/// What a sensor of the IMU reads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reading {
    /// rad/s or m/s².
    pub(super) value: f64,
    /// The variance of its noise.
    pub(super) variance: f64,
    /// How much older it is than the filter's state, s: samples may come later than the poses of
    /// their time.
    pub(super) age: f64,
    /// The tangent of the front wheels' angle at its time.
    pub(super) tangent: f64,
}

/// How the front wheels stand in the middle of a step, and how they turn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wheels {
    /// Tangent of their angle.
    pub(super) tangent: f64,
    /// Its change, 1/s.
    pub(super) change: f64,
}

/// The motion by a filter, with covariances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Navigation {
    /// Position of G (world frame, m) and yaw (rad).
    pub(super) pose: Vector3<f64>,
    /// Velocity of G forward and to the left (m/s), and yaw rate (rad/s).
    pub(super) twist: Vector3<f64>,
    pub(super) pose_covariance: Matrix3<f64>,
    pub(super) twist_covariance: Matrix3<f64>,
}

impl Navigation {
    /// Whether all of the motion is a number.
    pub(super) fn is_finite(&self) -> bool {
        let mut all = self.pose.iter().chain(&self.twist);
        all.all(|value| value.is_finite())
    }

    /// The variance of the direction of the velocity, rad².
    pub(super) fn sideslip_variance(&self) -> f64 {
        // An error of the velocity turns it as far as it does not lengthen it.
        let across = Vector3::new(-self.twist.y, self.twist.x, 0.0);
        across.dot(&(self.twist_covariance * across)) / square(across.norm_squared())
    }

    /// The weighted mean of several motions, with their spread in its covariances.
    pub(super) fn mean(all: &[Self; 3], weights: [f64; 3]) -> Self {
        let ([a, b, c], [of_a, of_b, of_c]) = (all, weights);
        let sum = |of: fn(&Self) -> Vector3<f64>| of_a * of(a) + of_b * of(b) + of_c * of(c);
        let mut mean = Self {
            pose: sum(|one| one.pose),
            twist: sum(|one| one.twist),
            pose_covariance: Matrix3::zeros(),
            twist_covariance: Matrix3::zeros(),
        };
        for (one, weight) in all.iter().zip(weights) {
            let (pose, twist) = (one.pose - mean.pose, one.twist - mean.twist);
            mean.pose_covariance += weight * (one.pose_covariance + pose * pose.transpose());
            mean.twist_covariance += weight * (one.twist_covariance + twist * twist.transpose());
        }
        mean
    }
}

impl Filter {
    /// A filter that starts at a pose, with zero velocity.
    pub(super) fn at_pose(prior: Prior, pose: &CarPose, config: &EstimatorConfig) -> Self {
        let mut mean = StateVector::zeros();
        mean[X] = pose.position.x;
        mean[Y] = pose.position.y;
        mean[YAW] = pose.yaw;
        let with_steering = |deviation: f64| if prior.steering { deviation } else { 0.0 };
        let mut deviations = StateVector::zeros();
        deviations[X] = config.position_noise;
        deviations[Y] = config.position_noise;
        deviations[YAW] = config.yaw_noise;
        deviations[SPEED] = INITIAL_SPEED;
        deviations[ACCELERATION] = 0.5;
        deviations[SLIP] = INITIAL_SLIP;
        deviations[TURN] = INITIAL_TURN[usize::from(!prior.steering)];
        deviations[TURN_CHANGE] = if prior.steering { 0.0 } else { 1.0 };
        deviations[GYRO_BIAS] = INITIAL_GYRO_BIAS;
        deviations[GYRO_SCALE] = config.gyro_scale_noise;
        deviations[MOTOR_SCALE] = INITIAL_MOTOR_SCALE;
        deviations[STEERING_GAIN] = with_steering(INITIAL_STEERING_GAIN);
        deviations[STEERING_TRIM] = with_steering(INITIAL_STEERING_TRIM);
        deviations[COMPLIANCE] = INITIAL_COMPLIANCE;
        deviations[FORWARD_BIAS] = INITIAL_FORWARD_BIAS;
        Self {
            prior,
            mean,
            covariance: Covariance::from_diagonal(&deviations.map(square)),
            usual: CONSISTENT,
            before: Vector3::zeros(),
            persistent: 0.0,
            likelihood: 0.0,
        }
    }

    /// The estimated yaw, rad.
    pub(super) fn yaw(&self) -> f64 {
        self.mean[YAW]
    }

    /// Counts the yaw from the turn in which another one (rad) is.
    pub(super) fn count_turns_as(&mut self, yaw: f64) {
        self.mean[YAW] = unwrap_near(self.mean[YAW], yaw);
    }

    /// A filter of the same prior that has lost the car starts again at a pose, with the speed and
    /// the bias of one that has not.
    pub(super) fn found_by(&self, other: &Self, pose: &CarPose, config: &EstimatorConfig) -> Self {
        let mut found = Self::at_pose(self.prior, pose, config);
        found.mean[SPEED] = other.mean[SPEED];
        found.mean[GYRO_BIAS] = other.mean[GYRO_BIAS];
        found
    }

    /// The estimated gyro bias, rad/s.
    pub(super) fn gyro_bias(&self) -> f64 {
        self.mean[GYRO_BIAS]
    }

    /// The estimated scale of the gyro: what it reads of a yaw rate.
    pub(super) fn gyro_scale(&self) -> f64 {
        1.0 + self.mean[GYRO_SCALE]
    }

    /// The estimated bias of the forward accelerometer, m/s².
    pub(super) fn forward_bias(&self) -> f64 {
        self.mean[FORWARD_BIAS]
    }

    /// The estimated forward speed, m/s.
    pub(super) fn speed(&self) -> f64 {
        self.mean[SPEED]
    }

    /// Yaw rate `age` seconds ago with wheels whose angle had this tangent, and its gradient.
    fn yaw_rate(&self, tangent: f64, age: f64, wheelbase: f64) -> (f64, StateVector) {
        let mut gradient = StateVector::zeros();
        gradient[TURN] = 1.0;
        if !self.prior.steering {
            gradient[TURN_CHANGE] = -age;
            return (self.mean[TURN] - age * self.mean[TURN_CHANGE], gradient);
        }
        let speed = self.mean[SPEED] - age * self.mean[ACCELERATION];
        let curvature =
            (tangent * (1.0 + self.mean[STEERING_GAIN]) + self.mean[STEERING_TRIM]) / wheelbase;
        gradient[SPEED] = curvature;
        gradient[ACCELERATION] = -age * curvature;
        gradient[STEERING_GAIN] = speed * tangent / wheelbase;
        gradient[STEERING_TRIM] = speed / wheelbase;
        (speed * curvature + self.mean[TURN], gradient)
    }

    /// Speed of G to the left at this yaw rate, and its gradient.
    fn left(&self, (yaw_rate, of_rate): (f64, &StateVector), rear: f64) -> (f64, StateVector) {
        let speed = self.mean[SPEED];
        let arm = rear - self.mean[COMPLIANCE] * speed * speed;
        let mut gradient = of_rate * arm;
        gradient[SLIP] += 1.0;
        gradient[COMPLIANCE] -= speed * speed * yaw_rate;
        gradient[SPEED] -= 2.0 * self.mean[COMPLIANCE] * speed * yaw_rate;
        (self.mean[SLIP] + arm * yaw_rate, gradient)
    }

    /// Acceleration of G to the left, m/s².
    pub(super) fn left_acceleration(&self, tangent: f64, config: &EstimatorConfig) -> f64 {
        self.mean[SPEED] * self.yaw_rate(tangent, 0.0, config.wheelbase).0
    }

    /// Predicts over `dt` seconds, in which the wheels move as given.
    pub(super) fn predict(&mut self, dt: f64, wheels: &Wheels, config: &EstimatorConfig) {
        let (rate, of_rate) = self.yaw_rate(wheels.tangent, 0.0, config.wheelbase);
        let (left, of_left) = self.left((rate, &of_rate), config.rear_axle_distance);
        let (s, c) = sincos(self.mean[YAW] + 0.5 * rate * dt);
        let forward = self.mean[SPEED] + 0.5 * self.mean[ACCELERATION] * dt;
        let fade = |time: f64| exp(-dt / time);
        let [kept_acceleration, kept_slip] = [FORWARD_TIME, SLIP_TIME].map(fade);

        let mut jacobian = SMatrix::<f64, MOVING, STATES>::zeros();
        for state in 0..MOVING {
            jacobian[(state, state)] = 1.0;
        }
        let across = [-forward * s - left * c, forward * c - left * s];
        for (row, along, aside, turned) in [(X, c, -s, across[0]), (Y, s, c, across[1])] {
            for state in SPEED..STATES {
                jacobian[(row, state)] +=
                    dt * (aside * of_left[state] + 0.5 * dt * turned * of_rate[state]);
            }
            jacobian[(row, YAW)] += turned * dt;
            jacobian[(row, SPEED)] += along * dt;
            jacobian[(row, ACCELERATION)] += 0.5 * along * dt * dt;
        }
        for state in SPEED..STATES {
            jacobian[(YAW, state)] += of_rate[state] * dt;
        }
        jacobian[(SPEED, ACCELERATION)] = dt;
        jacobian[(ACCELERATION, ACCELERATION)] = kept_acceleration;
        jacobian[(SLIP, SLIP)] = kept_slip;
        self.mean[X] += dt * (forward * c - left * s);
        self.mean[Y] += dt * (forward * s + left * c);
        self.mean[YAW] += rate * dt;
        self.mean[SPEED] += self.mean[ACCELERATION] * dt;
        self.mean[ACCELERATION] *= kept_acceleration;
        self.mean[SLIP] *= kept_slip;
        if self.prior.steering {
            let kept = fade(TURN_TIME);
            jacobian[(TURN, TURN)] = kept;
            self.mean[TURN] *= kept;
        } else {
            let kept = fade(YAW_ACCELERATION[1]);
            jacobian[(TURN, TURN_CHANGE)] = dt;
            jacobian[(YAW, TURN_CHANGE)] += 0.5 * dt * dt;
            jacobian[(TURN_CHANGE, TURN_CHANGE)] = kept;
            self.mean[YAW] += 0.5 * self.mean[TURN_CHANGE] * dt * dt;
            self.mean[TURN] += self.mean[TURN_CHANGE] * dt;
            self.mean[TURN_CHANGE] *= kept;
        }
        self.propagate(&jacobian);
        self.add_noise(dt, rate, wheels, (s, c), config);
    }

    fn propagate(&mut self, jacobian: &SMatrix<f64, MOVING, STATES>) {
        let rows: SMatrix<f64, MOVING, STATES> = jacobian * self.covariance;
        let moving: SMatrix<f64, MOVING, MOVING> = rows * jacobian.transpose();
        let cross = rows.fixed_columns::<FIXED>(MOVING).into_owned();
        self.covariance
            .fixed_view_mut::<MOVING, MOVING>(0, 0)
            .copy_from(&moving);
        self.covariance
            .fixed_view_mut::<MOVING, FIXED>(0, MOVING)
            .copy_from(&cross);
        self.covariance
            .fixed_view_mut::<FIXED, MOVING>(MOVING, 0)
            .copy_from(&cross.transpose());
    }

    /// Adds what the prediction over `dt` seconds does not know, at this yaw rate and heading.
    fn add_noise(
        &mut self,
        dt: f64,
        rate: f64,
        wheels: &Wheels,
        (s, c): (f64, f64),
        config: &EstimatorConfig,
    ) {
        let speed = self.mean[SPEED];
        let forward = square(self.prior.forward) * (1.0 - exp(-2.0 * dt / FORWARD_TIME));
        self.add_changing(SPEED, ACCELERATION, forward, dt);
        let [always, sliding] = self.prior.slip;
        let slip = square(always + sliding * fabs(speed * speed * rate)) * dt;
        self.covariance[(SLIP, SLIP)] += slip;
        let (second, third) = (0.5 * slip * dt, slip * dt * dt / 3.0);
        for (state, aside) in [(X, -s), (Y, c)] {
            self.add_both(state, SLIP, aside * second);
            self.covariance[(state, state)] += aside * aside * third;
        }
        self.add_both(X, Y, -s * c * third);
        if self.prior.steering {
            let [always, turning, steering] = self.prior.turn;
            let commanded = fabs(speed * wheels.change / config.wheelbase);
            let turn = square(always + turning * fabs(rate) + steering * commanded) * dt;
            self.add_changing(YAW, TURN, turn, dt);
        } else {
            let [deviation, time] = YAW_ACCELERATION;
            let turn = square(deviation) * (1.0 - exp(-2.0 * dt / time));
            self.add_changing(TURN, TURN_CHANGE, turn, dt);
        }
        for (bias, walk) in [
            (GYRO_BIAS, config.gyro_bias_walk),
            (FORWARD_BIAS, config.acceleration_bias_walk),
        ] {
            self.covariance[(bias, bias)] += square(walk) * dt;
        }
    }

    /// Adds noise of this variance to a state that changes another one, over `dt` seconds.
    fn add_changing(&mut self, state: usize, change: usize, variance: f64, dt: f64) {
        self.covariance[(change, change)] += variance;
        self.covariance[(state, state)] += variance * dt * dt / 3.0;
        self.add_both(state, change, 0.5 * variance * dt);
    }

    fn add_both(&mut self, one: usize, other: usize, covariance: f64) {
        self.covariance[(one, other)] += covariance;
        self.covariance[(other, one)] += covariance;
    }

    /// Corrects with the gyro; returns the square of the innovation less what the filter expects of it
    /// without the sensor's noise.
    pub(super) fn correct_gyro(&mut self, gyro: &Reading, config: &EstimatorConfig) -> f64 {
        let scale = self.gyro_scale();
        let (rate, gradient) = self.yaw_rate(gyro.tangent, gyro.age, config.wheelbase);
        let mut row = gradient * scale;
        row[GYRO_SCALE] = rate;
        row[GYRO_BIAS] = 1.0;
        let innovation = gyro.value - (scale * rate + self.mean[GYRO_BIAS]);
        let variance = gyro.variance * self.doubt();
        square(innovation) - self.correct_scalar(&row, innovation, variance, GYRO_OUTLIER)
    }

    /// Corrects with the forward accelerometer, as [`Filter::correct_gyro`]: when the wheels lock or
    /// spin, it tells.
    pub(super) fn correct_acceleration(&mut self, it: &Reading, config: &EstimatorConfig) -> f64 {
        let (rate, of_rate) = self.yaw_rate(it.tangent, it.age, config.wheelbase);
        let (left, _) = self.left((rate, &of_rate), config.rear_axle_distance);
        let mut row = StateVector::zeros();
        row[ACCELERATION] = 1.0;
        row[FORWARD_BIAS] = 1.0;
        let expected = self.mean[ACCELERATION] - left * rate + self.mean[FORWARD_BIAS];
        let innovation = it.value - expected;
        let variance = it.variance * self.doubt();
        square(innovation) - self.correct_scalar(&row, innovation, variance, GYRO_OUTLIER)
    }

    /// How many times less than they say the samples of the IMU count: their error is not white where
    /// one pose after the other contradicts them in the same direction.
    fn doubt(&self) -> f64 {
        self.persistent.max(1.0)
    }

    /// Corrects with the speed from the motor pulses (m/s), which is `age` seconds old.
    pub(super) fn correct_motor(&mut self, motor_speed: f64, age: f64, config: &EstimatorConfig) {
        let scale = 1.0 + self.mean[MOTOR_SCALE];
        let speed = self.mean[SPEED] - age * self.mean[ACCELERATION];
        let mut row = StateVector::zeros();
        row[SPEED] = scale;
        row[ACCELERATION] = -age * scale;
        row[MOTOR_SCALE] = speed;
        let innovation = motor_speed - scale * speed;
        let noise = config.motor_speed_noise + config.motor_speed_scale_noise * fabs(motor_speed);
        self.correct_scalar(&row, innovation, square(noise), MOTOR_OUTLIER);
    }

    /// Returns the variance that the filter expects without that of the sensor.
    fn correct_scalar(
        &mut self,
        row: &StateVector,
        innovation: f64,
        variance: f64,
        outlier: f64,
    ) -> f64 {
        let projected = self.covariance * row;
        let expected = row.dot(&projected);
        let spread = expected + variance;
        let normalised = square(innovation) / spread;
        let gain = projected / (spread * (normalised / outlier).max(1.0));
        self.mean += gain * innovation;
        self.covariance -= gain * projected.transpose();
        self.likelihood -= 0.5 * (normalised.min(GYRO_OUTLIER) + log(spread));
        self.settle();
        expected
    }

    /// Corrects with a pose. Returns its normalised innovation squared (3 degrees of freedom),
    /// and whether it was within the gate; otherwise only the likelihood changes.
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
        let entropy = log(fabs(spread.determinant()));
        let normalised = innovation.dot(&(inverse * innovation));
        // What the model lacks widens the gate, not the noise.
        let lacking = Vector3::new(config.position_gate, config.position_gate, config.yaw_gate);
        let widened = spread + Matrix3::from_diagonal(&(lacking / GATE_DEVIATIONS).map(square));
        let within = widened.try_inverse().is_some_and(|inverse| {
            // A NaN is outside.
            innovation.dot(&(inverse * innovation)) <= square(GATE_DEVIATIONS)
        });
        if !within {
            self.likelihood -= 0.5 * (REFUSED + entropy);
            return (normalised, false);
        }
        self.likelihood -= 0.5 * (normalised.min(LEAST_LIKELY) + entropy);
        let outlier = OUTLIER * (self.usual / CONSISTENT).max(1.0);
        self.usual += SHARE * (normalised.min(MOST * outlier) - self.usual);
        let product = self.before.dot(&(inverse * innovation));
        self.persistent += SHARE * (product.clamp(-outlier, MOST * outlier) - self.persistent);
        self.before = innovation;
        let scatter = ((self.usual - self.persistent.max(0.0)) / CONSISTENT).max(1.0);
        let spread = predicted + Matrix3::from_diagonal(&(noise * scatter));
        let inverse = spread.try_inverse().unwrap_or(inverse) / (normalised / outlier).max(1.0);
        let gain = self.covariance.fixed_columns::<3>(0) * inverse;
        self.mean += gain * innovation;
        self.covariance -= gain * self.covariance.fixed_rows::<3>(0).into_owned();
        self.settle();
        (normalised, true)
    }

    /// Keeps the covariance symmetric, and the scales in their bounds.
    fn settle(&mut self) {
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose());
        for scale in [GYRO_SCALE, MOTOR_SCALE] {
            self.mean[scale] = self.mean[scale].clamp(-SCALE_BOUND, SCALE_BOUND);
        }
    }

    /// Whether mean and covariance are finite.
    pub(super) fn is_finite(&self) -> bool {
        self.mean.iter().all(|value| value.is_finite())
            && self.covariance.iter().all(|value| value.is_finite())
    }

    /// The motion with wheels whose angle has this tangent.
    pub(super) fn navigation(&self, tangent: f64, config: &EstimatorConfig) -> Navigation {
        let (yaw_rate, of_yaw_rate) = self.yaw_rate(tangent, 0.0, config.wheelbase);
        let (left, of_left) = self.left((yaw_rate, &of_yaw_rate), config.rear_axle_distance);
        let mut of_forward = StateVector::zeros();
        of_forward[SPEED] = 1.0;
        let gradients = SMatrix::from_columns(&[of_forward, of_left, of_yaw_rate]);
        Navigation {
            pose: self.mean.fixed_rows::<3>(X).into_owned(),
            twist: Vector3::new(self.mean[SPEED], left, yaw_rate),
            pose_covariance: self.covariance.fixed_view::<3, 3>(X, X).into_owned(),
            twist_covariance: gradients.tr_mul(&(self.covariance * gradients)),
        }
    }
}

fn square(value: f64) -> f64 {
    value * value
}
