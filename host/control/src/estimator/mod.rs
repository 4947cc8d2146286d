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

mod bank;
mod filter;

use heapless::Deque;
use libm::{atan, atan2, hypot, tan};
use nalgebra::Vector3;

use self::{
    bank::{Bank, SAMPLE_PERIOD, Sample, Sent},
    filter::{Filter, Navigation},
};
use crate::{
    measurement::{Covariance, Estimate, InertialSample, PoseSample, Position, Time, direction},
    single_track::VehicleParameters,
    words,
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
    pub const fn acceleration_variance(&self, squared_speed: f64) -> f64 {
        let rest = self.acceleration_noise_density;
        let vibration = self.vibration_noise_density;
        rest * rest + vibration * vibration * squared_speed
    }

    /// For a motion capture with deviations of 0.2 mm and 0.1 degrees, and a consumer IMU.
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
    /// The number of implausible poses in a row.
    pub implausible_in_a_row: u32,
}

/// The estimate since its first pose.
#[derive(Clone, Debug)]
struct Track {
    bank: Bank,
    /// Mid-exposure of the last accepted pose.
    pose_time: Time,
    poses: u32,
    /// The normalised innovation squared of the last pose, accepted or not.
    innovation: f64,
    /// The position and yaw of the last estimate, to hold them beyond the horizon.
    held: Option<Vector3<f64>>,
    /// The motion and the covariances of the last estimate.
    last: Option<Navigation>,
}

impl Estimator {
    /// An estimator before its first measurement.
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
            Some(track) if same_body => {
                track.poses = 0;
                track.bank.config = config;
            }
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

    /// The number of poses accepted since the estimate started.
    pub fn poses(&self) -> u32 {
        self.track.as_ref().map_or(0, |track| track.poses)
    }

    fn best(&self) -> Option<&Filter> {
        Some(self.track.as_ref()?.bank.best())
    }

    /// The estimated gyro bias, rad/s; 0 before the first pose.
    pub fn gyro_bias(&self) -> f64 {
        self.best().map_or(0.0, Filter::gyro_bias)
    }

    /// The estimated scale of the gyro, of what it reads to the yaw rate; 1 before the first pose.
    pub fn gyro_scale(&self) -> f64 {
        self.best().map_or(1.0, Filter::gyro_scale)
    }

    /// The estimated biases of the accelerometer, forward and left, m/s²; 0 before the first
    /// pose.
    pub fn acceleration_bias(&self) -> [f64; 2] {
        self.track.as_ref().map_or([0.0; 2], |track| {
            [track.bank.best().forward_bias(), track.bank.left_bias]
        })
    }

    /// The normalised innovation squared of the last pose that was not late, accepted or not: how
    /// far it was from its prediction, in squared standard deviations of its three coordinates,
    /// before it was weighted. A consistent estimate has a mean of 3. It is 0 for the first pose.
    pub fn innovation(&self) -> f64 {
        self.track.as_ref().map_or(0.0, |track| track.innovation)
    }

    /// The variance of the sideslip of the last estimate, rad²; infinite before the first one and at
    /// standstill.
    pub fn sideslip_variance(&self) -> f64 {
        let last = self.track.as_ref().and_then(|track| track.last);
        last.map_or(f64::INFINITY, |last| last.sideslip_variance())
    }

    /// The covariances of the last estimate; none before the first one.
    pub fn covariance(&self) -> Option<Covariance> {
        let last = self.track.as_ref()?.last?;
        // The upper triangle, by rows.
        let [pose, twist] = [last.pose_covariance, last.twist_covariance]
            .map(|of| [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|at| of[at]));
        Some(Covariance { pose, twist })
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
        let Some(track) = self.advance(pose.capture) else {
            return self.start(&measurement, pose.capture);
        };
        if pose.capture <= track.pose_time || pose.capture < track.bank.time {
            return PoseVerdict::Late;
        }
        let (innovation, within) = track.bank.correct_pose(&measurement);
        track.innovation = innovation;
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

    /// Starts the estimate at a pose.
    fn start(&mut self, pose: &CarPose, time: Time) -> PoseVerdict {
        if !(pose.position.x.is_finite() && pose.position.y.is_finite() && pose.yaw.is_finite()) {
            return PoseVerdict::Implausible;
        }
        self.track = Some(Track {
            bank: Bank::at_pose(pose, time, &self.config),
            pose_time: time,
            poses: 1,
            innovation: 0.0,
            held: None,
            last: None,
        });
        self.drop_samples_before(time);
        PoseVerdict::Accepted
    }

    /// Handles an inertial sample and the speed of the rear axle from the motor pulses
    /// (m/s) of the same telemetry; `None` if that does not measure it. A sample out of order or
    /// not finite is ignored.
    pub fn handle_inertial(&mut self, inertial: InertialSample, motor_speed: Option<f64>) {
        let finite = inertial.yaw_rate.is_finite()
            && inertial.forward_acceleration.is_finite()
            && inertial.left_acceleration.is_finite();
        if finite {
            self.handle_partial(inertial, motor_speed);
        }
    }

    /// Handles a sample of a car without an accelerometer, or without an IMU: as
    /// [`handle_inertial`](Self::handle_inertial), but NaN is what the car does not measure.
    pub fn handle_partial(&mut self, inertial: InertialSample, motor_speed: Option<f64>) {
        let newest = self
            .samples
            .back()
            .or(self.current.as_ref())
            .map_or(Time(0), |last| last.inertial.time);
        let finite = motor_speed.is_none_or(f64::is_finite);
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
        let bank = &self.advance(now.before(LAG))?.bank;
        let (is_finite, mut present) = (bank.is_finite(), self.forecast(now)?);
        if !(is_finite && present.is_finite()) {
            self.reset();
            return None;
        }
        if self.samples.is_empty() && self.current.is_none() {
            return None;
        }
        let track = self.track.as_mut()?;
        let within_horizon = now.seconds_since(track.pose_time) <= self.config.prediction_horizon;
        if let (MarkerLoss::Hold, Some(held)) = (self.config.marker_loss, track.held)
            && !within_horizon
        {
            // The car has gone on.
            let gone = present.pose - held;
            present.pose_covariance += gone * gone.transpose();
            present.pose = held;
        }
        track.held = Some(present.pose);
        track.last = Some(present);
        let pose_time = track.pose_time;
        let ([x, y, yaw], [forward, left, yaw_rate]) = (present.pose.into(), present.twist.into());
        let (speed, sideslip) = self.speed_and_sideslip(forward, left, self.sent.at(now));
        Some(Estimate {
            time: now,
            position: Position::new(x, y),
            yaw,
            yaw_rate,
            sideslip,
            speed,
            pose_time,
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

    /// Advances the filters to `end` with the samples up to it, unless they are beyond it.
    fn advance(&mut self, end: Time) -> Option<&mut Track> {
        let track = self.track.as_mut()?;
        let bank = &mut track.bank;
        if end < bank.time {
            return Some(track);
        }
        while let Some(next) = self.samples.front().copied()
            && next.inertial.time <= end
        {
            self.samples.pop_front();
            let elapsed = self.current.map_or(SAMPLE_PERIOD, |before| {
                next.inertial.time.seconds_since(before.inertial.time)
            });
            bank.go(next.inertial.time, &self.sent);
            bank.take(&next, &self.sent, Some(elapsed));
            self.current = Some(next);
        }
        bank.go(end, &self.sent);
        Some(track)
    }

    /// The motion at `end`, with the samples up to it. What it finds likely does not count yet.
    fn forecast(&self, end: Time) -> Option<Navigation> {
        let known = &self.track.as_ref()?.bank;
        let mut present = known.clone();
        for sample in &self.samples {
            if sample.inertial.time > end {
                break;
            }
            present.go(sample.inertial.time, &self.sent);
            present.take(sample, &self.sent, None);
        }
        present.go(end, &self.sent);
        Some(present.navigation(known.weights(), &self.sent))
    }
}
