//! The model left alone with what drove the car, beside what the car did: what the
//! paper's figures of its validation show.

use singletrack_control::{Tyres, wrap};

use super::{
    data::{DriveData, Pose, ServoTarget, Span},
    filter::TrackPoint,
    model::Model,
    parameter::{Parameter, Values},
    timeline::{Belief, Traveller, travel},
};

/// What was measured and what the model says, at an inertial sample.
///
/// Yaw rate, sideslip and acceleration of the model are never corrected; its
/// position and its yaw, which drift away with the smallest of errors, begin anew
/// from the filter's every [`Simulation::RESTART_S`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulationPoint {
    /// When, in s.
    pub time_s: f64,
    /// Steering angle of the model, in rad.
    pub steering_rad: f64,
    /// Speed of G that the model was given, in m/s.
    pub speed_m_s: f64,
    /// Yaw rate by the gyro less its bias, in rad/s.
    pub measured_yaw_rate_rad_s: f64,
    /// And of the model.
    pub yaw_rate_rad_s: f64,
    /// Sideslip by the cameras alone, in rad; not a number without enough poses.
    pub measured_sideslip_rad: f64,
    /// And of the model.
    pub sideslip_rad: f64,
    /// Acceleration to the left less its bias, in m/s².
    pub measured_left_m_s2: f64,
    /// And of the model.
    pub left_m_s2: f64,
    /// Yaw by the filter, in rad, not wrapped.
    pub measured_yaw_rad: f64,
    /// And of the model.
    pub yaw_rad: f64,
    /// Position of G by the filter, in m.
    pub measured_m: [f64; 2],
    /// And of the model.
    pub position_m: [f64; 2],
    /// Whether position and yaw of the model begin anew here.
    pub restarted: bool,
}

/// The model beside the drive.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Simulation {
    /// At each inertial sample of the stretches.
    pub points: Vec<SimulationPoint>,
}

impl Simulation {
    /// After so long position and yaw of the model begin anew, in s.
    pub const RESTART_S: f64 = 10.0;
}

pub(super) fn simulate(
    data: &DriveData,
    servo: &[ServoTarget],
    spans: &[Span],
    values: &Values,
    tyres: Tyres,
    track: &[TrackPoint],
) -> Option<Simulation> {
    let model = Model::new(values, *values.all(), tyres);
    let mut runner = Runner {
        data,
        model,
        track: track.iter(),
        belief: None,
        now: 0.0,
        since: 0.0,
        forward_bias: 0.0,
        points: Vec::with_capacity(track.len()),
    };
    for span in spans {
        runner.now = span.start_s;
        travel(data, servo, *span, &model, &mut runner)?;
    }
    Some(Simulation {
        points: runner.points,
    })
}

struct Runner<'a> {
    data: &'a DriveData,
    model: Model<f64>,
    track: core::slice::Iter<'a, TrackPoint>,
    belief: Option<Belief<f64>>,
    now: f64,
    /// Since position and yaw began anew, in s.
    since: f64,
    forward_bias: f64,
    points: Vec<SimulationPoint>,
}

impl Traveller<f64> for Runner<'_> {
    fn begin(&mut self, belief: Belief<f64>) {
        self.belief = Some(belief);
        self.since = f64::INFINITY;
    }

    fn advance(&mut self, step: f64, target: f64, forward: [f64; 2]) -> Option<()> {
        let belief = self.belief.as_mut()?;
        let forward = forward.map(|forward| forward - self.forward_bias);
        belief.motion = self.model.advance(belief.motion, step, target, forward)?;
        self.now += step;
        self.since += step;
        Some(())
    }

    fn inertial(&mut self, index: usize, forward: f64) {
        let (Some(belief), Some(sample)) = (&mut self.belief, self.data.inertial.get(index)) else {
            return;
        };
        // The filter has met the same samples in the same order.
        let Some(track) = self.track.next() else {
            return;
        };
        let motion = &mut belief.motion;
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
            measured_sideslip_rad: seen_sideslip(&self.data.poses, self.now),
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

/// Over how long to either side the cameras' sideslip is measured, in s: at 0.2 mm,
/// 0.1 degrees and 1.5 m/s to 2 mrad.
const AROUND: f64 = 0.036;
/// With fewer poses there is none.
const LEAST_POSES: usize = 5;

/// The direction in which the poses move less the one in which they point.
fn seen_sideslip(poses: &[Pose], time: f64) -> f64 {
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
