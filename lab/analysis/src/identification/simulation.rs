//! The model without corrections, with the inputs of the drive, and the measurements beside
//! it: the paper's validation figures, and how well they fit.

use singletrack_control::words;

use super::{
    data::{Drive, Span, seen},
    filter::{FilterRun, TrackPoint},
    model::{Model, Motion},
    parameter::{Parameter, Values},
    settings::Settings,
    timeline::{EventHandler, STATES, StateEstimate},
};
use crate::dual::Dual;

/// Measured and simulated values at an inertial sample.
///
/// Yaw rate, sideslip and acceleration of the model are never corrected. Its position and
/// yaw integrate every error and drift; they restart from the filter's every ten seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulationPoint {
    /// Time, in s.
    pub time_s: f64,
    /// Steering angle of the model, in rad.
    pub steering_rad: f64,
    /// Speed of G, an input of the model, in m/s.
    pub speed_m_s: f64,
    /// Yaw rate from the gyro without its bias, in rad/s; of a car without one, from the cameras.
    pub measured_yaw_rate_rad_s: f64,
    /// Yaw rate of the model, in rad/s.
    pub yaw_rate_rad_s: f64,
    /// Sideslip from the cameras alone, in rad; not a number without enough poses.
    pub measured_sideslip_rad: f64,
    /// Sideslip of the model, in rad.
    pub sideslip_rad: f64,
    /// Acceleration to the left without its bias, in m/s²; NaN without an accelerometer.
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

/// The time after which position and yaw of the model restart, in s.
const RESTART_S: f64 = 10.0;

/// The model, alone since the stretch began, at a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Simulated<D> {
    /// Nominal time, in s.
    pub(super) time_s: f64,
    pub(super) sample: Sample,
    pub(super) motion: Motion<D>,
    /// Acceleration to the left, in m/s²; zero at a pose.
    pub(super) left: D,
    /// Whether position and yaw restart here.
    pub(super) restarted: bool,
}

/// The sample at which the model is compared.
#[derive(Clone, Copy, Debug)]
pub(super) enum Sample {
    /// An inertial sample, with the filter's estimate there.
    Inertial(TrackPoint),
    /// The pose with this index.
    Pose(usize),
}

/// Simulates the stretches of a drive, with the filter's estimate of its speed and of the biases. None
/// where the model is not defined.
pub(super) fn simulated<D: Dual>(
    drive: Drive<'_>,
    run: &FilterRun,
    model: &Model<D>,
) -> Option<Vec<Simulated<D>>> {
    let zero = D::from(0.0);
    let mut simulator = Simulator {
        model: *model,
        track: run.track.iter(),
        estimate: StateEstimate::of([zero; STATES], zero),
        now: 0.0,
        since: 0.0,
        forward_bias: 0.0,
        points: Vec::with_capacity(drive.data.poses.len() + run.track.len()),
    };
    drive.replay(model, &run.gains.order, &mut simulator)?;
    Some(simulator.points)
}

/// Simulates the stretches of a drive, beside what was measured: a point per inertial sample. None
/// where the model is not defined.
pub(super) fn simulate(
    drive: Drive<'_>,
    run: &FilterRun,
    values: &Values,
    settings: &Settings,
) -> Option<Vec<SimulationPoint>> {
    let model = Model::new(values, *values.all(), settings);
    let points = simulated(drive, run, &model)?.into_iter();
    let points = points.filter_map(|simulated| {
        let Simulated { motion, left, .. } = simulated;
        let Sample::Inertial(track) = simulated.sample else {
            return None;
        };
        let sample = drive.data.inertial[track.inertial];
        let estimate = track.estimate;
        let unbiased = sample.yaw_rate_rad_s - estimate.gyro_bias;
        let seen = seen(&drive.data.poses, simulated.time_s);
        let yaw_rate = match sample.yaw_rate_rad_s.is_nan() {
            false => unbiased / values.get(Parameter::GyroScale),
            true => seen.map_or(f64::NAN, |seen| seen.yaw_rate),
        };
        Some(SimulationPoint {
            time_s: simulated.time_s,
            steering_rad: motion.steering,
            speed_m_s: motion.speed,
            measured_yaw_rate_rad_s: yaw_rate,
            yaw_rate_rad_s: motion.yaw_rate,
            measured_sideslip_rad: seen.map_or(f64::NAN, |seen| seen.sideslip),
            sideslip_rad: motion.sideslip,
            measured_left_m_s2: sample.left_m_s2 - values.get(Parameter::LateralBias),
            left_m_s2: left,
            measured_yaw_rad: estimate.motion.yaw,
            yaw_rad: motion.yaw,
            measured_m: [estimate.motion.x, estimate.motion.y],
            position_m: [motion.x, motion.y],
            restarted: simulated.restarted,
        })
    });
    Some(points.collect())
}

struct Simulator<'a, D> {
    model: Model<D>,
    track: core::slice::Iter<'a, TrackPoint>,
    estimate: StateEstimate<D>,
    now: f64,
    /// Time since the last restart, in s.
    since: f64,
    forward_bias: f64,
    points: Vec<Simulated<D>>,
}

impl<D: Dual> EventHandler<D> for Simulator<'_, D> {
    fn begin(&mut self, time: f64, estimate: StateEstimate<D>) {
        self.now = time;
        self.estimate = estimate;
        self.since = f64::INFINITY;
    }

    fn advance(&mut self, step: D, target: f64, forward: [D; 2]) -> Option<()> {
        let motion = &mut self.estimate.motion;
        let forward = forward.map(|forward| forward - self.forward_bias);
        *motion = self.model.advance(*motion, step, target, forward)?;
        self.now += step.re();
        self.since += step.re();
        Some(())
    }

    fn inertial(&mut self, _: usize, forward: D) {
        // The track has the same samples in the same order.
        let Some(track) = self.track.next() else {
            return;
        };
        let motion = &mut self.estimate.motion;
        let seen = track.estimate.motion;
        motion.speed = D::from(seen.speed);
        self.forward_bias = track.estimate.forward_bias;
        let restarted = self.since > RESTART_S;
        if restarted {
            self.since = 0.0;
            [motion.x, motion.y, motion.yaw] = [seen.x, seen.y, seen.yaw].map(D::from);
        }
        let forward = forward - self.forward_bias;
        let left = self.model.left_acceleration(motion, forward);
        self.points.push(Simulated {
            time_s: self.now,
            sample: Sample::Inertial(*track),
            motion: *motion,
            left,
            restarted,
        });
    }

    fn pose(&mut self, index: usize) {
        self.points.push(Simulated {
            time_s: self.now,
            sample: Sample::Pose(index),
            motion: self.estimate.motion,
            left: D::from(0.0),
            restarted: false,
        });
    }
}

words! {
    /// A compared output of the model.
    pub enum Output {
        /// Yaw rate against the gyro.
        YawRate = "yaw_rate",
        /// Sideslip against the cameras.
        Sideslip = "sideslip",
        /// Acceleration to the left against the IMU.
        Left = "left_acceleration",
    }
}

impl Output {
    /// The measured and the simulated value.
    pub const fn of(self, point: &SimulationPoint) -> [f64; 2] {
        match self {
            Self::YawRate => [point.measured_yaw_rate_rad_s, point.yaw_rate_rad_s],
            Self::Sideslip => [point.measured_sideslip_rad, point.sideslip_rad],
            Self::Left => [point.measured_left_m_s2, point.left_m_s2],
        }
    }
}

/// How well an output fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputScore {
    /// The output.
    pub output: Output,
    /// Mean of |model - measured| over the standard deviation of the measured values.
    pub nmpe: f64,
    /// 100 (1 - |model - measured| / |measured - mean|) with norms over the drive: 100 is
    /// perfect, 0 is no better than the mean.
    pub fit_percent: f64,
    /// Root mean square of model - measured, in the output's unit.
    pub rms: f64,
}

/// How well the model fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// The normalised mean prediction error: the mean over the outputs that are measured.
    pub nmpe: f64,
    /// The score of each output; NaN of one that is not measured.
    pub outputs: [OutputScore; 3],
}

impl Score {
    pub(super) fn of(simulation: &[SimulationPoint]) -> Self {
        let all = Span {
            start_s: f64::NEG_INFINITY,
            end_s: f64::INFINITY,
        };
        Self::within(simulation, all)
    }

    /// The score of a part of a simulation.
    pub fn within(simulation: &[SimulationPoint], span: Span) -> Self {
        let outputs = Output::ALL.map(|output| {
            let points = simulation.iter();
            let points = points.filter(|point| span.contains(point.time_s));
            let pairs = points.map(|point| output.of(point));
            let pairs: Vec<_> = pairs
                .filter(|[measured, model]| measured.is_finite() && model.is_finite())
                .collect();
            // Without a pair, all are not a number.
            let count = pairs.len() as f64;
            let mean = pairs.iter().map(|[measured, _]| measured).sum::<f64>() / count;
            let spread: f64 = pairs.iter().map(|[y, _]| (y - mean) * (y - mean)).sum();
            let errors = pairs.iter().map(|[y, model]| model - y);
            let squares: f64 = errors.map(|error| error * error).sum();
            let absolute: f64 = pairs.iter().map(|[y, model]| (model - y).abs()).sum();
            OutputScore {
                output,
                nmpe: absolute / count / (spread / count).sqrt(),
                fit_percent: 100.0 * (1.0 - (squares / spread).sqrt()),
                rms: (squares / count).sqrt(),
            }
        });
        let measured = outputs.iter().filter(|output| !output.rms.is_nan());
        let nmpe: f64 = measured.clone().map(|output| output.nmpe).sum();
        Self {
            nmpe: nmpe / measured.count() as f64,
            outputs,
        }
    }
}
