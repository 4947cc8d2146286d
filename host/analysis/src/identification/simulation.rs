//! The model without corrections, with the inputs of the drive, and the measurements beside
//! it: the paper's validation figures.

use singletrack_control::{Tyres, wrap};

use super::{
    data::{DriveData, Pose, ServoTarget, Span},
    filter::TrackPoint,
    model::Model,
    parameter::{Parameter, Values},
    timeline::{EventHandler, StateEstimate, replay},
};

/// Measured and simulated values at an inertial sample.
///
/// Yaw rate, sideslip and acceleration of the model are never corrected. Its position and
/// yaw integrate every error and drift; they restart from the filter's after each
/// [`Simulation::RESTART_S`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulationPoint {
    /// Time, in s.
    pub time_s: f64,
    /// Steering angle of the model, in rad.
    pub steering_rad: f64,
    /// Speed of G, an input of the model, in m/s.
    pub speed_m_s: f64,
    /// Yaw rate from the gyro without its bias, in rad/s.
    pub measured_yaw_rate_rad_s: f64,
    /// Yaw rate of the model, in rad/s.
    pub yaw_rate_rad_s: f64,
    /// Sideslip from the cameras alone, in rad; not a number without enough poses.
    pub measured_sideslip_rad: f64,
    /// Sideslip of the model, in rad.
    pub sideslip_rad: f64,
    /// Acceleration to the left without its bias, in m/s².
    pub measured_left_m_s2: f64,
    /// Acceleration to the left of the model, in m/s².
    pub left_m_s2: f64,
    /// Yaw from the filter, in rad, not wrapped.
    pub measured_yaw_rad: f64,
    /// Yaw of the model, in rad, not wrapped.
    pub yaw_rad: f64,
    /// Position of G from the filter, in m.
    pub measured_m: [f64; 2],
    /// Position of G of the model, in m.
    pub position_m: [f64; 2],
    /// Whether position and yaw of the model restart at this sample.
    pub restarted: bool,
}

/// The simulated and the measured drive.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Simulation {
    /// One point per inertial sample of the stretches.
    pub points: Vec<SimulationPoint>,
}

impl Simulation {
    /// The time after which position and yaw of the model restart, in s.
    pub const RESTART_S: f64 = 10.0;
}

/// Simulates the stretches of a drive. None where the model is not defined.
pub(super) fn simulate(
    data: &DriveData,
    servo: &[ServoTarget],
    spans: &[Span],
    values: &Values,
    tyres: Tyres,
    track: &[TrackPoint],
) -> Option<Simulation> {
    let model = Model::new(values, *values.all(), tyres);
    let mut simulator = Simulator {
        data,
        model,
        track: track.iter(),
        estimate: None,
        now: 0.0,
        since: 0.0,
        forward_bias: 0.0,
        points: Vec::with_capacity(track.len()),
    };
    for span in spans {
        simulator.now = span.start_s;
        replay(data, servo, *span, &model, &mut simulator)?;
    }
    Some(Simulation {
        points: simulator.points,
    })
}

struct Simulator<'a> {
    data: &'a DriveData,
    model: Model<f64>,
    track: core::slice::Iter<'a, TrackPoint>,
    estimate: Option<StateEstimate<f64>>,
    now: f64,
    /// Time since the last restart, in s.
    since: f64,
    forward_bias: f64,
    points: Vec<SimulationPoint>,
}

impl EventHandler<f64> for Simulator<'_> {
    fn begin(&mut self, estimate: StateEstimate<f64>) {
        self.estimate = Some(estimate);
        self.since = f64::INFINITY;
    }

    fn advance(&mut self, step: f64, target: f64, forward: [f64; 2]) -> Option<()> {
        let estimate = self.estimate.as_mut()?;
        let forward = forward.map(|forward| forward - self.forward_bias);
        estimate.motion = self.model.advance(estimate.motion, step, target, forward)?;
        self.now += step;
        self.since += step;
        Some(())
    }

    fn inertial(&mut self, index: usize, forward: f64) {
        let (Some(estimate), Some(sample)) = (&mut self.estimate, self.data.inertial.get(index))
        else {
            return;
        };
        // The track has the same samples in the same order.
        let Some(track) = self.track.next() else {
            return;
        };
        let motion = &mut estimate.motion;
        motion.speed = track.speed_m_s;
        self.forward_bias = track.forward_bias_m_s2;
        let restarted = self.since > Simulation::RESTART_S;
        if restarted {
            self.since = 0.0;
            (motion.x, motion.y, motion.yaw) = (track.x_m, track.y_m, track.yaw_rad);
        }
        let left = self
            .model
            .left_acceleration(motion, forward - self.forward_bias);
        self.points.push(SimulationPoint {
            time_s: self.now,
            steering_rad: motion.steering,
            speed_m_s: motion.speed,
            measured_yaw_rate_rad_s: sample.yaw_rate_rad_s - track.gyro_bias_rad_s,
            yaw_rate_rad_s: motion.yaw_rate,
            measured_sideslip_rad: measured_sideslip(&self.data.poses, self.now),
            sideslip_rad: motion.sideslip,
            measured_left_m_s2: sample.left_m_s2 - self.model.get(Parameter::LateralBias),
            left_m_s2: left,
            measured_yaw_rad: track.yaw_rad,
            yaw_rad: motion.yaw,
            measured_m: [track.x_m, track.y_m],
            position_m: [motion.x, motion.y],
            restarted,
        });
    }

    fn pose(&mut self, _: usize) {}
}

/// The sideslip is measured over poses up to this time before and after, in s: with errors
/// of 0.2 mm and 0.1 degrees at 1.5 m/s to 2 mrad.
const AROUND: f64 = 0.036;
/// The smallest number of poses for a sideslip.
const LEAST_POSES: usize = 5;

/// The course of the poses around `time` minus their yaw, in rad.
fn measured_sideslip(poses: &[Pose], time: f64) -> f64 {
    let from = poses.partition_point(|pose| pose.time_s < time - AROUND);
    let to = poses.partition_point(|pose| pose.time_s <= time + AROUND);
    let Some(around) = poses
        .get(from..to)
        .filter(|poses| poses.len() >= LEAST_POSES)
    else {
        return f64::NAN;
    };
    let Some(first) = around.first() else {
        return f64::NAN;
    };
    let count = around.len() as f64;
    let mean = |value: &dyn Fn(&Pose) -> f64| around.iter().map(value).sum::<f64>() / count;
    let middle = mean(&|pose| pose.time_s - time);
    let slope = |value: &dyn Fn(&Pose) -> f64| {
        let mean = mean(value);
        let (mut product, mut square) = (0.0, 0.0);
        for pose in around {
            let since = pose.time_s - time - middle;
            product += since * (value(pose) - mean);
            square += since * since;
        }
        product / square
    };
    let (x, y) = (slope(&|pose| pose.x_m), slope(&|pose| pose.y_m));
    let yaw = &|pose: &Pose| wrap(pose.yaw_rad - first.yaw_rad);
    wrap(y.atan2(x) - first.yaw_rad - mean(yaw))
}
