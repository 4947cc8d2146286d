//! From poses, IMU and motor pulses to position, yaw, yaw rate, sideslip and
//! speed.
//!
//! Poses arrive late (exposure, processing, network), inertial samples early.
//! So the filter runs behind: it stays at the last pose's mid-exposure, keeps
//! the inertial samples since, and predicts the present from there anew at
//! every tick.

mod filter;

use filter::{Filter, Navigation};
use heapless::Deque;
use libm::{atan, atan2, hypot, tan};

use crate::{Estimate, InertialSample, PoseSample, Position, Time, VehicleParameters, direction};

/// What the estimator does while the markers are lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MarkerLoss {
    /// Position and yaw keep their last value, as in the paper; yaw rate and
    /// sideslip stay live.
    #[default]
    Hold,
    /// Position and yaw are predicted from IMU and motor speed.
    DeadReckon,
}

/// The estimator's parameters, in SI units and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorConfig {
    /// What to do while the markers are lost.
    pub marker_loss: MarkerLoss,
    /// Position of the rigid body's origin from G, in the car's axes: forward, left.
    pub marker_offset: [f64; 2],
    /// Yaw of the rigid body when the car's yaw is zero.
    pub marker_yaw: f64,
    /// Distance from G to the rear axle, and wheelbase.
    pub rear_axle_distance: f64,
    /// Wheelbase.
    pub wheelbase: f64,
    /// Standard deviation of a pose's coordinate, m.
    pub position_noise: f64,
    /// Standard deviation of a pose's yaw, rad.
    pub yaw_noise: f64,
    /// Difference from the prediction at which a pose is refused, beyond the
    /// statistical one, m.
    pub position_gate: f64,
    /// The same for yaw, rad.
    pub yaw_gate: f64,
    /// Gyro noise density, rad/s/√Hz.
    pub gyro_noise_density: f64,
    /// Random walk of the gyro bias, rad/s²/√Hz.
    pub gyro_bias_walk: f64,
    /// Accelerometer noise density with the car's vibration, m/s²/√Hz.
    pub acceleration_noise_density: f64,
    /// Random walk of the accelerometer bias, m/s³/√Hz.
    pub acceleration_bias_walk: f64,
    /// Standard deviation of the motor's speed at standstill, m/s.
    pub motor_speed_noise: f64,
    /// Standard deviation of the motor's speed, in proportion to it (tyre radius).
    pub motor_speed_scale_noise: f64,
    /// Standard deviation of the rear axle's sideways speed, m/s.
    pub rear_slip_noise: f64,
    /// How far beyond the last pose's mid-exposure position and yaw may be
    /// predicted under [`MarkerLoss::Hold`], s: covers the latency of a pose
    /// that arrives, not one that does not.
    pub prediction_horizon: f64,
}

impl EstimatorConfig {
    /// For a car under a motion capture of 0.2 mm and 0.1 degrees, with a
    /// consumer IMU.
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
            gyro_noise_density: 5e-4,
            gyro_bias_walk: 1e-4,
            acceleration_noise_density: 0.02,
            acceleration_bias_walk: 2e-3,
            motor_speed_noise: 0.02,
            motor_speed_scale_noise: 0.05,
            rear_slip_noise: 0.03,
            prediction_horizon: 0.03,
        }
    }
}

/// Pose of the car: of its centre of mass, from a pose of the rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarPose {
    /// Position of the centre of mass G on the floor, world frame, in m.
    pub position: Position,
    /// Yaw of the car, in rad, on the circle.
    pub yaw: f64,
}

/// How many inertial samples are kept: 0.64 s at 100 Hz.
const SAMPLES: usize = 64;

/// How far the filter may lag behind, s: a pose older than this comes too late.
const LAG: f64 = 0.15;

/// A longer gap between inertial samples ends the track, s.
const LONGEST_GAP: f64 = 0.2;

/// Below this speed sideslip follows from steering alone, m/s.
const KINEMATIC_BELOW: f64 = 0.05;
/// Above this speed sideslip follows from the velocity alone, m/s.
const DYNAMIC_ABOVE: f64 = 0.15;

/// An inertial sample with the motor speed that came with it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Sample {
    inertial: InertialSample,
    motor_speed: f64,
}

/// What became of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseVerdict {
    /// It corrected the estimate, or started it.
    Accepted,
    /// It is older than what was used already.
    Late,
    /// It differs too much from what gyro and speed predict.
    Implausible,
}

/// Fuses motion capture, IMU and motor speed.
#[derive(Clone, Debug)]
pub struct Estimator {
    config: EstimatorConfig,
    track: Option<Track>,
    samples: Deque<Sample, SAMPLES>,
    /// The sample in force at the filter's time.
    current: Option<Sample>,
    implausible_in_a_row: u32,
}

/// The filter from the first pose on.
#[derive(Clone, Debug)]
struct Track {
    filter: Filter,
    time: Time,
    pose_time: Time,
    poses: u32,
    /// The last pose that was predicted within the horizon.
    held: Option<(Position, f64)>,
}

impl Estimator {
    /// An estimator that has seen nothing.
    #[must_use]
    pub const fn new(config: EstimatorConfig) -> Self {
        Self {
            config,
            track: None,
            samples: Deque::new(),
            current: None,
            implausible_in_a_row: 0,
        }
    }

    /// Forgets the track; the next pose starts a new one.
    pub fn reset(&mut self) {
        self.track = None;
        self.implausible_in_a_row = 0;
    }

    /// How many poses in a row were implausible.
    #[must_use]
    pub const fn implausible_in_a_row(&self) -> u32 {
        self.implausible_in_a_row
    }

    /// How many poses the track has accepted.
    #[must_use]
    pub fn poses(&self) -> u32 {
        self.track.as_ref().map_or(0, |track| track.poses)
    }

    /// The gyro bias that it believes in, rad/s.
    #[must_use]
    pub fn gyro_bias(&self) -> f64 {
        self.track
            .as_ref()
            .map_or(0.0, |track| track.filter.gyro_bias())
    }

    /// Takes in a pose.
    pub fn handle_pose(&mut self, pose: &PoseSample) -> PoseVerdict {
        let measurement = self.centre_of_mass(pose);
        let Some(track) = &mut self.track else {
            if !(measurement.position.x.is_finite()
                && measurement.position.y.is_finite()
                && measurement.yaw.is_finite())
            {
                return PoseVerdict::Implausible;
            }
            self.track = Some(Track {
                filter: Filter::at_pose(&measurement, &self.config),
                time: pose.capture,
                pose_time: pose.capture,
                poses: 1,
                held: None,
            });
            self.drop_samples_before(pose.capture);
            return PoseVerdict::Accepted;
        };
        if pose.capture <= track.pose_time || pose.capture < track.time {
            return PoseVerdict::Late;
        }
        advance(
            track,
            &mut self.samples,
            &mut self.current,
            pose.capture,
            &self.config,
        );
        if !track.filter.correct_pose(&measurement, &self.config) {
            self.implausible_in_a_row = self.implausible_in_a_row.saturating_add(1);
            return PoseVerdict::Implausible;
        }
        track.pose_time = pose.capture;
        // However late it comes, it replaces what was held.
        track.held = None;
        track.poses = track.poses.saturating_add(1);
        self.implausible_in_a_row = 0;
        PoseVerdict::Accepted
    }

    /// Takes in an inertial sample and the speed of the rear axle by the motor
    /// pulses (m/s) that came with it. Samples must come in order of time; one that
    /// does not is left out.
    pub fn handle_inertial(&mut self, inertial: InertialSample, motor_speed: f64) {
        let newest = self
            .samples
            .back()
            .or(self.current.as_ref())
            .map_or(Time(0), |last| last.inertial.time);
        let finite = inertial.yaw_rate.is_finite()
            && inertial.forward_acceleration.is_finite()
            && inertial.left_acceleration.is_finite()
            && motor_speed.is_finite();
        if inertial.time <= newest || !finite {
            return;
        }
        if newest > Time(0) && inertial.time.seconds_since(newest) > LONGEST_GAP {
            // Nobody knows how the car moved meanwhile; to guess would teach
            // the filter a wrong bias.
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
        // Never full here.
        let _ = self.samples.push_back(sample);
    }

    /// The estimate for `now`, with the steering angle commanded (rad); none
    /// before the first pose and the first inertial sample.
    pub fn estimate(&mut self, now: Time, steering: f64) -> Option<Estimate> {
        let track = self.track.as_mut()?;
        let oldest = now.before(LAG);
        if oldest > track.time {
            advance(
                track,
                &mut self.samples,
                &mut self.current,
                oldest,
                &self.config,
            );
        }
        if !track.filter.is_finite() {
            self.reset();
            return None;
        }
        let newest = self.samples.back().or(self.current.as_ref())?;
        let present = predict_mean(track, &self.samples, self.current.as_ref(), now)
            .navigation(&newest.inertial);

        let within_horizon = now.seconds_since(track.pose_time) <= self.config.prediction_horizon;
        let (position, yaw) = match (self.config.marker_loss, track.held) {
            (MarkerLoss::Hold, Some(held)) if !within_horizon => held,
            _ => (present.position, present.yaw),
        };
        track.held = Some((position, yaw));

        let (speed, sideslip) = self.speed_and_sideslip(&present, steering);
        Some(Estimate {
            time: now,
            position,
            yaw,
            yaw_rate: present.yaw_rate,
            sideslip,
            speed,
            pose_time: self.track.as_ref()?.pose_time,
        })
    }

    /// Signed speed, and sideslip that turns kinematic where the velocity is
    /// too small to have a direction.
    fn speed_and_sideslip(&self, navigation: &Navigation, steering: f64) -> (f64, f64) {
        let Navigation { forward, left, .. } = *navigation;
        let pace = hypot(forward, left);
        let sign = if forward < 0.0 { -1.0 } else { 1.0 };
        let weight = ((pace - KINEMATIC_BELOW) / (DYNAMIC_ABOVE - KINEMATIC_BELOW)).clamp(0.0, 1.0);
        let kinematic =
            atan(self.config.rear_axle_distance / self.config.wheelbase * tan(steering));
        let dynamic = atan2(sign * left, sign * forward);
        (sign * pace, kinematic + weight * (dynamic - kinematic))
    }

    /// The pose of G that belongs to a pose of the markers.
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

/// Advances the filter to `end`, through the samples on the way.
fn advance(
    track: &mut Track,
    samples: &mut Deque<Sample, SAMPLES>,
    current: &mut Option<Sample>,
    end: Time,
    config: &EstimatorConfig,
) {
    while let Some(next) = samples.front().copied()
        && next.inertial.time <= end
    {
        samples.pop_front();
        if next.inertial.time > track.time {
            // A sample holds from its own time on; before the first one, it
            // is the best guess for the time before it too.
            let inertial = current.as_ref().unwrap_or(&next).inertial;
            let dt = next.inertial.time.seconds_since(track.time);
            track.filter.predict(dt, &inertial, config);
            track.time = next.inertial.time;
            track
                .filter
                .correct_wheels(next.motor_speed, &next.inertial, config);
        }
        *current = Some(next);
    }
    if end > track.time {
        if let Some(sample) = current {
            let dt = end.seconds_since(track.time);
            track.filter.predict(dt, &sample.inertial, config);
        }
        track.time = end;
    }
}

/// The filter's mean predicted to `end`, the filter itself untouched.
fn predict_mean(
    track: &Track,
    samples: &Deque<Sample, SAMPLES>,
    current: Option<&Sample>,
    end: Time,
) -> Filter {
    let mut filter = track.filter;
    let mut time = track.time;
    let mut in_force = current.or(samples.front()).map(|sample| sample.inertial);
    for sample in samples {
        if sample.inertial.time > end {
            break;
        }
        if sample.inertial.time > time {
            if let Some(inertial) = in_force {
                filter.predict_mean(sample.inertial.time.seconds_since(time), &inertial);
            }
            time = sample.inertial.time;
        }
        in_force = Some(sample.inertial);
    }
    if let Some(inertial) = in_force
        && end > time
    {
        filter.predict_mean(end.seconds_since(time), &inertial);
    }
    filter
}
