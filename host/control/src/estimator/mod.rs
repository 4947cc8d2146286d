//! The estimator: position, yaw, yaw rate, sideslip and speed from poses, gyro, motor pulses and the
//! steering that was sent.
//!
//! Poses arrive later than inertial samples (exposure, processing, network). The filters
//! therefore stay at the mid-exposure of the last pose and keep the inertial samples
//! since; every tick goes on to the present from there.
//!
//! Three filters take in the same: one that believes the steering, one that believes it three times
//! less, and one that does not know it. The estimate is their mean, weighted by how likely each made
//! the measurements of the last third of a second: a servo that is stuck, reversed or loose costs
//! accuracy, and nothing else.

mod filter;
mod wheels;

use heapless::Deque;
use libm::{atan, atan2, exp, fabs, hypot, tan};
use singletrack_words::words;

use self::{
    filter::{Filter, Navigation, Prior, Reading},
    wheels::Sent,
};
use crate::{
    measurement::{Estimate, InertialSample, PoseSample, Time},
    point::{Position, direction},
    vehicle::VehicleParameters,
};

words! {
    /// What the estimator does during a marker loss.
    #[derive(Default)]
    pub enum MarkerLoss: serde {
        /// Position and yaw keep their last value, as in the paper; yaw rate, sideslip and
        /// speed are still estimated.
        #[default]
        Hold = "hold",
        /// Position and yaw are predicted from IMU and motor speed.
        DeadReckon = "dead-reckon",
    }
}

/// The estimator's parameters, in SI units and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorConfig {
    /// What to do during a marker loss.
    pub marker_loss: MarkerLoss,
    /// Position of the rigid body's origin relative to G, in the car's axes (forward,
    /// left), m.
    pub marker_offset: [f64; 2],
    /// Yaw of the rigid body when the car's yaw is zero, rad.
    pub marker_yaw: f64,
    /// Distance from G to the rear axle, m.
    pub rear_axle_distance: f64,
    /// Distance between the axles, m.
    pub wheelbase: f64,
    /// Standard deviation of a pose's coordinate, m.
    pub position_noise: f64,
    /// Standard deviation of a pose's yaw, rad.
    pub yaw_noise: f64,
    /// Innovation gate: a pose is rejected if it differs from the prediction by more than
    /// this beyond five standard deviations, m; position and yaw together, as an ellipsoid.
    pub position_gate: f64,
    /// The innovation gate of yaw, rad.
    pub yaw_gate: f64,
    /// Gyro noise density, rad/s/√Hz, before it is learned.
    pub gyro_noise_density: f64,
    /// Standard deviation of the gyro's scale from one, before anything is measured: 0 takes it
    /// for exact.
    pub gyro_scale_noise: f64,
    /// Random walk of the gyro bias, rad/s²/√Hz.
    pub gyro_bias_walk: f64,
    /// Accelerometer noise density of a car at rest, m/s²/√Hz.
    pub acceleration_noise_density: f64,
    /// What the car's vibration adds to it per speed, m/s²/√Hz per m/s.
    pub vibration_noise_density: f64,
    /// Random walk of the accelerometer bias, m/s³/√Hz.
    pub acceleration_bias_walk: f64,
    /// Standard deviation of the speed from the motor pulses at standstill, m/s.
    pub motor_speed_noise: f64,
    /// Standard deviation of that speed per speed: the tyre radius is not exact.
    pub motor_speed_scale_noise: f64,
    /// From a steering command to the first movement of the front wheels, s.
    pub steering_dead_time: f64,
    /// Time constant of the front wheels' angle, s.
    pub steering_lag: f64,
    /// The longest prediction of position and yaw from the last pose's mid-exposure under
    /// [`MarkerLoss::Hold`], s. It compensates the latency of a pose, and ends when one is
    /// missing.
    pub prediction_horizon: f64,
}

impl EstimatorConfig {
    /// The power of the accelerometer's noise at a squared speed (m²/s²), m²/s⁴/Hz.
    #[must_use]
    pub const fn acceleration_variance(&self, squared_speed: f64) -> f64 {
        let (rest, vibration) = (
            self.acceleration_noise_density,
            self.vibration_noise_density,
        );
        rest * rest + vibration * vibration * squared_speed
    }

    /// For a motion capture with deviations of 0.2 mm and 0.1 degrees, and a consumer IMU.
    #[must_use]
    pub const fn for_vehicle(vehicle: &VehicleParameters) -> Self {
        Self {
            marker_loss: MarkerLoss::Hold,
            marker_offset: [0.0, 0.0],
            marker_yaw: 0.0,
            rear_axle_distance: vehicle.rear_axle_distance_m,
            wheelbase: vehicle.wheelbase_m(),
            position_noise: 2e-4,
            yaw_noise: 1.7e-3,
            position_gate: 0.05,
            yaw_gate: 0.15,
            gyro_noise_density: 5e-3,
            acceleration_bias_walk: 2e-3,
            gyro_scale_noise: 0.03,
            gyro_bias_walk: 1e-4,
            acceleration_noise_density: 0.05,
            vibration_noise_density: 0.1,
            motor_speed_noise: 0.02,
            motor_speed_scale_noise: 0.05,
            steering_dead_time: 18.0 * 1e-3,
            steering_lag: 0.04,
            prediction_horizon: 0.03,
        }
    }
}

/// The measured pose of the car, from that of the rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarPose {
    /// Position of the centre of mass G on the floor, world frame, in m.
    pub position: Position,
    /// Yaw of the car, in rad; any multiple of 2π may be added.
    pub yaw: f64,
}

/// The result of handling a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PoseVerdict {
    /// The pose corrected the estimate, or started it.
    Accepted,
    /// The pose is not newer than the last one, or older than the lag of the filter.
    Late,
    /// The pose is outside the innovation gate, or not finite.
    Implausible,
}

/// The number of inertial samples kept: 0.64 s at 100 Hz.
const SAMPLES: usize = 64;

/// The largest lag of the filter, s: an older pose comes too late.
const LAG: f64 = 0.15;

/// The longest gap between inertial samples, s: a longer one restarts the estimate.
const LONGEST_GAP: f64 = 0.2;

/// Below this speed, sideslip follows from the steering alone, m/s.
const KINEMATIC_BELOW: f64 = 0.05;
/// Above this speed, sideslip follows from the velocity alone, m/s.
const DYNAMIC_ABOVE: f64 = 0.15;

/// A sample that is older than the filter's state by more than this no longer counts, s.
const OLDEST_SAMPLE: f64 = 0.05;

/// The longest step of a filter, s.
const LONGEST_STEP: f64 = 0.0101;

/// The filters: what each believes of the steering.
const PRIORS: [Prior; 3] = [
    Prior {
        steering: true,
        turn: [0.01, 0.015, 0.08],
        slip: [0.005, 0.01],
        forward: 0.5,
    },
    Prior {
        steering: true,
        turn: [0.04, 0.04, 0.15],
        slip: [0.02, 0.04],
        forward: 1.5,
    },
    Prior {
        steering: false,
        turn: [0.0; 3],
        slip: [0.1, 0.15],
        forward: 3.0,
    },
];
/// The one that believes the steering little, and the one without it.
const LOOSE: usize = 1;
const FREE: usize = 2;
/// What was likely is forgotten with this time constant, s.
const FORGETTING: f64 = 0.3;
/// The poses in a row after which a filter that refuses them alone has lost the car.
const LOST: u32 = 10;
/// The least weight of a filter.
const LEAST_WEIGHT: f64 = 1e-6;

/// The noise of gyro and accelerometer is learned with this time constant, s: the gyro's down to this
/// deviation of a sample, rad/s, and the accelerometer's not below the configured one. That of a car
/// that moves faster than this, m/s, is apart from that at rest.
const LEARNING: f64 = 1.0;
const QUIETEST_GYRO: f64 = 1e-3;
const QUIETER: f64 = 0.25;
const MOVES_FROM: f64 = 0.1;
/// A sample counts at most by this share in what is learned.
const MOST_AT_ONCE: f64 = 0.2;

/// The time constant of the accelerometer's mean error, s.
const BIAS_TIME: f64 = 20.0;

/// An inertial sample and the motor speed of the same telemetry.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sample {
    inertial: InertialSample,
    motor_speed: Option<f64>,
}

/// Fuses motion capture, IMU, motor speed and the steering that was sent in three extended Kalman
/// filters.
///
/// The filters stay at the mid-exposure of the last pose, and [`Estimator::estimate`] goes on to the
/// present from there. The estimate uses the commanded steering and survives its being wrong; no
/// mass, inertia or tyre stiffness is in it.
///
/// ```
/// use singletrack_control::{
///     Estimator, EstimatorConfig, InertialSample, PoseSample, PoseVerdict, Position, Time,
///     VehicleParameters,
/// };
///
/// let config = EstimatorConfig::for_vehicle(&VehicleParameters::paper());
/// let mut estimator = Estimator::new(config);
/// // A car that stands at (1 m, 2 m): an inertial sample and a pose every 10 ms.
/// let mut now = Time(1_000_000_000);
/// for frame in 0..20 {
///     let inertial = InertialSample {
///         time: now,
///         yaw_rate: 0.0,
///         forward_acceleration: 0.0,
///         left_acceleration: 0.0,
///     };
///     estimator.handle_inertial(inertial, Some(0.0));
///     let pose = PoseSample {
///         capture: now.before(0.005),
///         receive: now,
///         frame,
///         position: Position::new(1.0, 2.0),
///         yaw: 0.3,
///     };
///     assert_eq!(estimator.handle_pose(&pose), PoseVerdict::Accepted);
///     now = now.after(0.01);
/// }
/// let estimate = estimator.estimate(now).ok_or("no estimate")?;
/// assert!((estimate.position - Position::new(1.0, 2.0)).norm() < 1e-3);
/// assert!(estimate.speed.abs() < 1e-3);
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Debug)]
pub struct Estimator {
    config: EstimatorConfig,
    track: Option<Track>,
    sent: Sent,
    samples: Deque<Sample, SAMPLES>,
    /// The sample that holds at the filter's time.
    current: Option<Sample>,
    implausible_in_a_row: u32,
}

/// Variances of a sample: of the gyro, rad²/s², and of the forward accelerometer, m²/s⁴.
type Variances = [f64; 2];

/// The filters since their first pose.
#[derive(Clone, Debug)]
struct Track {
    filters: [Filter; 3],
    /// How likely each made the last measurements, as a logarithm.
    likelihoods: [f64; 3],
    /// The poses in a row that each refused and the best one accepted.
    refused: [u32; 3],
    /// The noise of the IMU at rest, and of a car that moves.
    noise: [Variances; 2],
    /// Mean error of the accelerometer to the left, m/s², and the number of samples.
    left_bias: f64,
    accelerations: u32,
    /// The time of the filters' state.
    time: Time,
    /// Mid-exposure of the last accepted pose.
    pose_time: Time,
    poses: u32,
    /// The normalised innovation squared of the last pose, accepted or not.
    innovation: f64,
    /// The position and yaw of the last estimate, to hold them beyond the horizon.
    held: Option<(Position, f64)>,
    /// The variance of the sideslip of the last estimate, rad².
    sideslip_variance: f64,
}

impl Track {
    fn at_pose(pose: &CarPose, time: Time, config: &EstimatorConfig) -> Self {
        Self {
            filters: PRIORS.map(|prior| Filter::at_pose(prior, pose, config)),
            likelihoods: [0.0; 3],
            refused: [0; 3],
            noise: [0.0, 1.0].map(|speed| configured_noise(speed, config)),
            left_bias: 0.0,
            accelerations: 0,
            time,
            pose_time: time,
            poses: 1,
            innovation: 0.0,
            held: None,
            sideslip_variance: f64::INFINITY,
        }
    }

    /// The weights of the filters, whose sum is 1.
    fn weights(&self) -> [f64; 3] {
        let most = self
            .likelihoods
            .into_iter()
            .fold(f64::NEG_INFINITY, f64::max);
        let weights = self
            .likelihoods
            .map(|likely| exp(likely - most) + LEAST_WEIGHT);
        let sum: f64 = weights.iter().sum();
        weights.map(|weight| weight / sum)
    }

    /// The most likely filter.
    fn best(&self) -> usize {
        let [tight, loose, free] = self.likelihoods;
        match () {
            () if tight >= loose && tight >= free => 0,
            () if loose >= free => 1,
            () => FREE,
        }
    }

    /// Goes on to a time.
    fn go(&mut self, end: Time, sent: &Sent, config: &EstimatorConfig) {
        while end > self.time {
            let next = end.min(self.time.after(LONGEST_STEP));
            let dt = next.seconds_since(self.time);
            let wheels = sent.between(self.time, next);
            for filter in &mut self.filters {
                filter.predict(dt, &wheels, config);
            }
            let kept = exp(-dt / FORGETTING);
            self.likelihoods = self.likelihoods.map(|likely| likely * kept);
            self.time = next;
        }
    }

    /// Takes in a sample at its time, `elapsed` (s) after the one before. `learns` is false where the
    /// filters are only a forecast.
    fn take(
        &mut self,
        sample: &Sample,
        elapsed: f64,
        sent: &Sent,
        config: &EstimatorConfig,
        learns: bool,
    ) {
        let inertial = &sample.inertial;
        let age = self.time.seconds_since(inertial.time).max(0.0);
        if age > OLDEST_SAMPLE {
            return;
        }
        let tangent = tan(sent.at(inertial.time));
        let speed = self.filters[FREE].speed();
        let configured = configured_noise(speed, config);
        let regime = usize::from(fabs(speed) > MOVES_FROM);
        let [gyro, acceleration] = self.noise[regime];
        let variances = [gyro, acceleration];
        let [gyro, acceleration] =
            [inertial.yaw_rate, inertial.forward_acceleration].map(|value| Reading {
                value,
                variance: 0.0,
                age,
                tangent,
            });
        let gyro = Reading {
            variance: variances[0],
            ..gyro
        };
        let acceleration = Reading {
            variance: variances[1],
            ..acceleration
        };
        let shown = self.filters.each_mut().map(|filter| {
            let acceleration = filter.correct_acceleration(&acceleration, config);
            let gyro = filter.correct_gyro(&gyro, config);
            if let Some(motor_speed) = sample.motor_speed {
                filter.correct_motor(motor_speed, age, config);
            }
            [gyro, acceleration]
        });
        if learns {
            self.compare_accelerations(inertial, tangent, config);
            let share = (elapsed / LEARNING).min(MOST_AT_ONCE);
            let least = [square(QUIETEST_GYRO), square(QUIETER) * configured[1]];
            for (sensor, known) in self.noise[regime].iter_mut().enumerate() {
                let excess = shown[LOOSE][sensor].clamp(0.0, OUTLYING * *known);
                *known = (*known + share * (excess - *known)).max(least[sensor]);
            }
            self.take_likelihoods();
        }
    }

    /// What the accelerometer measures to the left beyond the motion, as a mean.
    fn compare_accelerations(
        &mut self,
        inertial: &InertialSample,
        tangent: f64,
        config: &EstimatorConfig,
    ) {
        let left = self.filters[self.best()].left_acceleration(tangent, config);
        self.accelerations = self.accelerations.saturating_add(1);
        let share = (SAMPLE_PERIOD / BIAS_TIME).max(1.0 / f64::from(self.accelerations));
        self.left_bias += share * (inertial.left_acceleration - left - self.left_bias);
    }

    /// Filters that go on refusing the poses that the best one accepts have lost the car, and start
    /// again. All count their turns alike, so that the mean of their yaws is one.
    fn find_lost(
        &mut self,
        results: &[(f64, bool); 3],
        best: usize,
        pose: &CarPose,
        config: &EstimatorConfig,
    ) {
        let known = self.filters[best];
        for (index, filter) in self.filters.iter_mut().enumerate() {
            let is_lost = results[best].1 && !results[index].1;
            let refused = &mut self.refused[index];
            *refused = if is_lost { *refused + 1 } else { 0 };
            if *refused >= LOST {
                *filter = filter.found_by(&known, pose, config);
                *refused = 0;
            }
            filter.count_turns_as(known.yaw());
        }
    }

    fn take_likelihoods(&mut self) {
        for (sum, filter) in self.likelihoods.iter_mut().zip(&mut self.filters) {
            *sum += core::mem::take(&mut filter.likelihood);
        }
    }

    /// The mean of the filters' motions, and the variance of its sideslip.
    fn navigation(&self, sent: &Sent, config: &EstimatorConfig) -> Navigation {
        let tangent = tan(sent.at(self.time));
        let weights = self.weights();
        let all = self
            .filters
            .map(|filter| filter.navigation(tangent, config));
        let mean = |of: fn(&Navigation) -> f64| -> f64 {
            all.iter()
                .zip(weights)
                .map(|(one, weight)| weight * of(one))
                .sum()
        };
        let (forward, left) = (mean(|one| one.forward), mean(|one| one.left));
        let spread: f64 = all
            .iter()
            .zip(weights)
            .map(|(one, weight)| {
                // The directions of both velocities differ by this angle.
                let across = one.left * forward - one.forward * left;
                let along = one.forward * forward + one.left * left;
                weight * (one.sideslip_variance + square(atan2(across, along)))
            })
            .sum();
        Navigation {
            position: Position::new(mean(|one| one.position.x), mean(|one| one.position.y)),
            yaw: mean(|one| one.yaw),
            yaw_rate: mean(|one| one.yaw_rate),
            forward,
            left,
            sideslip_variance: spread,
        }
    }
}

/// The variances of a sample by the configuration, at a speed (m/s).
fn configured_noise(speed: f64, config: &EstimatorConfig) -> Variances {
    let acceleration = config.acceleration_variance(speed * speed);
    [square(config.gyro_noise_density), acceleration].map(|density| density / SAMPLE_PERIOD)
}

/// The period of the inertial samples for which the times are meant, s.
const SAMPLE_PERIOD: f64 = 0.01;
/// A gyro sample counts at most as this multiple of the variance that is known.
const OUTLYING: f64 = 9.0;

impl Estimator {
    /// An estimator before its first measurement.
    #[must_use]
    pub const fn new(config: EstimatorConfig) -> Self {
        Self {
            config,
            track: None,
            sent: Sent::new(config.steering_dead_time, config.steering_lag),
            samples: Deque::new(),
            current: None,
            implausible_in_a_row: 0,
        }
    }

    /// Replaces the parameters. The estimate settles again; where the car is stays known, unless the
    /// body is another one: a ghost must not be taken for the car because a parameter has changed.
    pub fn reconfigure(&mut self, config: EstimatorConfig) {
        let same_body = config.marker_offset == self.config.marker_offset
            && config.marker_yaw.to_bits() == self.config.marker_yaw.to_bits();
        match &mut self.track {
            Some(track) if same_body => track.poses = 0,
            _ => *self = Self::new(config),
        }
        self.sent = Sent::new(config.steering_dead_time, config.steering_lag);
        self.config = config;
    }

    /// Restarts the estimate: the next pose starts a new filter. Inertial samples are kept.
    pub fn reset(&mut self) {
        self.track = None;
        self.implausible_in_a_row = 0;
    }

    /// The number of implausible poses in a row.
    #[must_use]
    pub const fn implausible_in_a_row(&self) -> u32 {
        self.implausible_in_a_row
    }

    /// The number of poses accepted since the estimate started.
    #[must_use]
    pub fn poses(&self) -> u32 {
        self.track.as_ref().map_or(0, |track| track.poses)
    }

    /// The estimated gyro bias, rad/s; 0 before the first pose.
    #[must_use]
    pub fn gyro_bias(&self) -> f64 {
        self.track
            .as_ref()
            .map_or(0.0, |track| track.filters[track.best()].gyro_bias())
    }

    /// The estimated scale of the gyro, of what it reads to the yaw rate; 1 before the first pose.
    #[must_use]
    pub fn gyro_scale(&self) -> f64 {
        self.track
            .as_ref()
            .map_or(1.0, |track| track.filters[track.best()].gyro_scale())
    }

    /// The estimated biases of the accelerometer, forward and left, m/s²; 0 before the first
    /// pose.
    #[must_use]
    pub fn acceleration_bias(&self) -> [f64; 2] {
        self.track.as_ref().map_or([0.0; 2], |track| {
            [track.filters[track.best()].forward_bias(), track.left_bias]
        })
    }

    /// The normalised innovation squared of the last pose that was not late, accepted or not: how
    /// far it was from its prediction, in squared standard deviations of its three coordinates,
    /// before it was weighted. A consistent estimate has a mean of 3. It is 0 for the first pose.
    #[must_use]
    pub fn innovation(&self) -> f64 {
        self.track.as_ref().map_or(0.0, |track| track.innovation)
    }

    /// The variance of the sideslip of the last estimate, rad²; infinite before the first one and at
    /// standstill.
    #[must_use]
    pub fn sideslip_variance(&self) -> f64 {
        self.track
            .as_ref()
            .map_or(f64::INFINITY, |track| track.sideslip_variance)
    }

    /// The steering angle `steering` (rad) is sent at `now`. One that is not finite is none.
    pub fn send(&mut self, now: Time, steering: f64) {
        if steering.is_finite() {
            self.sent.send(now, steering);
        }
    }

    /// Handles a pose. The first one starts the estimate; later ones must pass the
    /// innovation gate.
    pub fn handle_pose(&mut self, pose: &PoseSample) -> PoseVerdict {
        let measurement = self.centre_of_mass(pose);
        let Some(track) = &mut self.track else {
            if !(measurement.position.x.is_finite()
                && measurement.position.y.is_finite()
                && measurement.yaw.is_finite())
            {
                return PoseVerdict::Implausible;
            }
            self.track = Some(Track::at_pose(&measurement, pose.capture, &self.config));
            self.drop_samples_before(pose.capture);
            return PoseVerdict::Accepted;
        };
        if pose.capture <= track.pose_time || pose.capture < track.time {
            return PoseVerdict::Late;
        }
        let (samples, current) = (&mut self.samples, &mut self.current);
        advance(
            track,
            samples,
            current,
            &self.sent,
            pose.capture,
            &self.config,
        );
        let best = track.best();
        let config = &self.config;
        let results = track
            .filters
            .each_mut()
            .map(|filter| filter.correct_pose(&measurement, config));
        track.take_likelihoods();
        let (innovation, within) = results[best];
        track.innovation = innovation;
        track.find_lost(&results, best, &measurement, config);
        if !within {
            self.implausible_in_a_row = self.implausible_in_a_row.saturating_add(1);
            return PoseVerdict::Implausible;
        }
        track.pose_time = pose.capture;
        // An accepted pose replaces the held one, however old it is.
        track.held = None;
        track.poses = track.poses.saturating_add(1);
        self.implausible_in_a_row = 0;
        PoseVerdict::Accepted
    }

    /// Handles an inertial sample and the speed of the rear axle from the motor pulses
    /// (m/s) of the same telemetry; `None` if that does not measure it. A sample out of order or
    /// not finite is ignored.
    pub fn handle_inertial(&mut self, inertial: InertialSample, motor_speed: Option<f64>) {
        let newest = self
            .samples
            .back()
            .or(self.current.as_ref())
            .map_or(Time(0), |last| last.inertial.time);
        let finite = inertial.yaw_rate.is_finite()
            && inertial.forward_acceleration.is_finite()
            && inertial.left_acceleration.is_finite()
            && motor_speed.is_none_or(f64::is_finite);
        if inertial.time <= newest || !finite {
            return;
        }
        if newest > Time(0) && inertial.time.seconds_since(newest) > LONGEST_GAP {
            // The motion in between is unknown; predicting it would give the filter a
            // wrong bias.
            self.reset();
            self.samples.clear();
            self.current = None;
        }
        let sample = Sample {
            inertial,
            motor_speed,
        };
        if self.samples.is_full() {
            self.current = self.samples.pop_front();
        }
        // There is room: see above.
        let _ = self.samples.push_back(sample);
    }

    /// The estimate for `now`. `None` before the first pose and the first inertial sample.
    pub fn estimate(&mut self, now: Time) -> Option<Estimate> {
        let track = self.track.as_mut()?;
        let oldest = now.before(LAG);
        if oldest > track.time {
            let (samples, current) = (&mut self.samples, &mut self.current);
            advance(track, samples, current, &self.sent, oldest, &self.config);
        }
        if !track.filters.iter().all(Filter::is_finite) {
            self.reset();
            return None;
        }
        if self.samples.is_empty() && self.current.is_none() {
            return None;
        }
        let present = forecast(
            track,
            &self.samples,
            self.current.as_ref(),
            &self.sent,
            now,
            &self.config,
        );

        let within_horizon = now.seconds_since(track.pose_time) <= self.config.prediction_horizon;
        let (position, yaw) = match (self.config.marker_loss, track.held) {
            (MarkerLoss::Hold, Some(held)) if !within_horizon => held,
            _ => (present.position, present.yaw),
        };
        track.held = Some((position, yaw));

        let Navigation {
            forward,
            left,
            sideslip_variance,
            ..
        } = present;
        let (speed, sideslip) = self.speed_and_sideslip(forward, left, self.sent.at(now));
        let track = self.track.as_mut()?;
        track.sideslip_variance = sideslip_variance;
        Some(Estimate {
            time: now,
            position,
            yaw,
            yaw_rate: present.yaw_rate,
            sideslip,
            speed,
            pose_time: track.pose_time,
        })
    }

    /// Speed of G (m/s, negative in reverse) and sideslip (rad). At low speed the velocity
    /// has no reliable direction, and sideslip follows from the wheels:
    /// atan(`l_r`/L tan δ).
    fn speed_and_sideslip(&self, forward: f64, left: f64, wheels: f64) -> (f64, f64) {
        let pace = hypot(forward, left);
        let sign = if forward < 0.0 { -1.0 } else { 1.0 };
        let weight = ((pace - KINEMATIC_BELOW) / (DYNAMIC_ABOVE - KINEMATIC_BELOW)).clamp(0.0, 1.0);
        let kinematic = atan(self.config.rear_axle_distance / self.config.wheelbase * tan(wheels));
        let dynamic = atan2(sign * left, sign * forward);
        (sign * pace, kinematic + weight * (dynamic - kinematic))
    }

    /// The pose of the car for a pose of the rigid body.
    #[must_use]
    pub fn centre_of_mass(&self, pose: &PoseSample) -> CarPose {
        let yaw = pose.yaw - self.config.marker_yaw;
        let [forward, left] = self.config.marker_offset;
        let axis = direction(yaw);
        CarPose {
            position: pose.position
                - forward * axis
                - left * nalgebra::Vector2::new(-axis.y, axis.x),
            yaw,
        }
    }

    fn drop_samples_before(&mut self, time: Time) {
        while let Some(sample) = self.samples.front()
            && sample.inertial.time <= time
        {
            self.current = self.samples.pop_front();
        }
    }
}

/// Advances the filters to `end`, with the samples up to it.
fn advance(
    track: &mut Track,
    samples: &mut Deque<Sample, SAMPLES>,
    current: &mut Option<Sample>,
    sent: &Sent,
    end: Time,
    config: &EstimatorConfig,
) {
    while let Some(next) = samples.front().copied()
        && next.inertial.time <= end
    {
        samples.pop_front();
        track.go(next.inertial.time, sent, config);
        track.take(&next, interval(current.as_ref(), &next), sent, config, true);
        *current = Some(next);
    }
    track.go(end, sent, config);
}

/// The motion at `end`, with the samples up to it.
fn forecast(
    track: &Track,
    samples: &Deque<Sample, SAMPLES>,
    current: Option<&Sample>,
    sent: &Sent,
    end: Time,
    config: &EstimatorConfig,
) -> Navigation {
    let mut present = track.clone();
    let mut before = current;
    for sample in samples {
        if sample.inertial.time > end {
            break;
        }
        present.go(sample.inertial.time, sent, config);
        present.take(sample, interval(before, sample), sent, config, false);
        before = Some(sample);
    }
    present.go(end, sent, config);
    // What a forecast finds likely does not count yet.
    present.likelihoods = track.likelihoods;
    present.navigation(sent, config)
}

/// The time between two inertial samples, s; the usual one if there is none before.
fn interval(before: Option<&Sample>, next: &Sample) -> f64 {
    before.map_or(SAMPLE_PERIOD, |before| {
        next.inertial.time.seconds_since(before.inertial.time)
    })
}

fn square(value: f64) -> f64 {
    value * value
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    /// An estimator of a car that stands, and its time.
    fn standing(frames: i32, mut each: impl FnMut(i32, &mut Estimator)) -> (Estimator, Time) {
        let config = EstimatorConfig::for_vehicle(&VehicleParameters::paper());
        let mut estimator = Estimator::new(config);
        let mut now = Time(1_000_000_000);
        for frame in 0..frames {
            now = now.after(0.01);
            let inertial = InertialSample {
                time: now,
                yaw_rate: 0.0,
                forward_acceleration: 0.0,
                left_acceleration: 0.0,
            };
            estimator.handle_inertial(inertial, Some(0.0));
            each(frame, &mut estimator);
            let pose = PoseSample {
                capture: now.before(0.005),
                receive: now,
                frame,
                position: Position::new(1.0, 2.0),
                yaw: 0.3,
            };
            assert_eq!(estimator.handle_pose(&pose), PoseVerdict::Accepted);
        }
        (estimator, now)
    }

    #[test]
    fn filters_that_count_their_turns_otherwise_have_one_yaw() {
        let (mut estimator, now) = standing(50, |frame, estimator| {
            if frame == 30 {
                let track = estimator.track.as_mut().unwrap();
                track.filters[1].count_turns_as(0.3 + core::f64::consts::TAU);
                track.likelihoods = [0.0; 3];
            }
        });
        let estimate = estimator.estimate(now).unwrap();
        assert!(fabs(estimate.yaw - 0.3) < 0.01, "{}", estimate.yaw);
    }

    #[test]
    fn a_filter_that_alone_has_lost_the_car_finds_it_again() {
        let config = EstimatorConfig::for_vehicle(&VehicleParameters::paper());
        let elsewhere = CarPose {
            position: Position::new(4.0, -3.0),
            yaw: 2.0,
        };
        let (estimator, _) = standing(80, |frame, estimator| {
            if frame == 30 {
                let track = estimator.track.as_mut().unwrap();
                track.filters[FREE] = Filter::at_pose(PRIORS[FREE], &elsewhere, &config);
            }
        });
        let track = estimator.track.unwrap();
        assert!(fabs(track.filters[FREE].yaw() - 0.3) < 0.05);
    }
}
