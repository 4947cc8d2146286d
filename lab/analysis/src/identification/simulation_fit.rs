//! The fit that minimises the errors of a simulation.
//!
//! A prediction corrects the model at each sample. Where the car has more effects than the model, the
//! corrections take them up, and the parameters that predict the next sample best may simulate badly.
//! This fit leaves yaw rate and sideslip of the model alone for the whole stretch, as
//! [`super::simulation`] does, and minimises the product of the root mean squares of its errors. They are
//! correlated over seconds: all of an output within [`BLOCK`] count as one beside the prior.
//!
//! Speed and biases are those of a filter, which depends on the parameters: the cost of a point is that with
//! a run of the filter there.

use nalgebra::{DMatrix, DVector};

use super::{
    data::{self, Channel, GyroScale, ServoFrames, ServoTarget, Span},
    error::Result,
    filter::FilterRun,
    fit::{Fit, Task, spread},
    least_squares::Problem,
    model::Model,
    parameter::Parameter,
    settings::NoiseLevels,
    simulation::{Sample, simulated},
};
use crate::dual::Dual;

/// Errors of the simulation farther apart than this count as independent, in s.
const BLOCK: f64 = 2.0;
/// The filter, whose speed and biases depend on the parameters, runs again at most so often.
const FILTER_RUNS: usize = 20;
/// Parts of the way to the minimum with the last run of the filter: the first one where the cost is lower
/// is gone.
const PARTS: [f64; 3] = [1.0, 0.5, 0.25];
/// The cost may be above the least one so often in a row: a run of the filter later it may be below.
const PATIENCE: usize = 3;
/// The fit ends where the cost falls by less than this: 0.14 standard deviations.
const FALL: f64 = 0.01;
/// The largest number of steps with one run of the filter.
const STEPS: usize = 60;
/// The last step with one run of the filter is below this, in standard deviations: the next run moves the
/// minimum by more.
const SETTLED: f64 = 0.5;
/// A start that comes so near to the way of an earlier one goes on like that, in standard deviations.
const JOINED: f64 = 1.0;
/// The damping of the first step, in shares of the curvature of the squares.
const DAMPING: f64 = 1e-2;
/// With this damping, a step is too short to matter.
const MOST_DAMPING: f64 = 1e6;
/// Where further fits start, by factors on stiffness in front, stiffness in the rear and yaw inertia.
const STARTS: [[f64; 3]; 4] = [
    [1.0, 1.0, 1.0],
    [0.5, 0.5, 1.0],
    [2.0, 2.0, 1.0],
    [0.6, 1.6, 2.0],
];

/// A drive, and what its simulations have in common.
struct Simulations<'a> {
    task: &'a Task<'a>,
    frames: ServoFrames,
    servo: Vec<ServoTarget>,
    /// The levels of the filter, of which only the speed and the biases are used.
    noise: NoiseLevels,
    scale: Option<GyroScale>,
    /// Yaw rate (rad/s) and sideslip (rad) of the cameras at each pose; NaN without enough poses.
    seen: Vec<[f64; 2]>,
    /// Whether a gyro measures the yaw rate, and an accelerometer the acceleration to the left.
    measures: [bool; 2],
}

/// A simulation with its errors.
#[derive(Clone, Copy)]
struct Simulated<'a> {
    of: &'a Simulations<'a>,
    run: &'a FilterRun,
    /// What the errors of yaw rate, sideslip and acceleration are divided by, see [`Cost::sizes`].
    sizes: [f64; 3],
}

/// The number of an output, and the time, in s.
type Place = (usize, f64);

/// The number of the gyro's scale among them.
const SCALE: usize = 3;

impl Problem for Simulated<'_> {
    fn errors<D: Dual>(&self, u: &[D]) -> Option<Vec<D>> {
        let placed = self.placed(u)?.into_iter();
        Some(placed.map(|(_, error)| error).collect())
    }
}

impl Simulated<'_> {
    /// The errors over their sizes, each with its place.
    fn placed<D: Dual>(&self, u: &[D]) -> Option<Vec<(Place, D)>> {
        let (of, task) = (self.of, self.of.task);
        let (data, start, settings) = (task.data, &task.start, task.settings);
        let model = Model::new(start, start.moved(&settings.parameters, u), settings);
        let [gyro, accelerometer] = of.measures;
        let mut errors = Vec::with_capacity(3 * data.poses.len());
        let mut push = |output: usize, time: f64, error: D| {
            errors.push(((output, time), error / self.sizes[output]));
        };
        for simulated in simulated(task.drive(&of.servo), self.run, &model)? {
            let time = simulated.time_s;
            match simulated.sample {
                Sample::Inertial(track) => {
                    let sample = data.inertial[track.inertial];
                    if gyro {
                        let turn = simulated.motion.yaw_rate * model.get(Parameter::GyroScale);
                        let expected = turn + track.estimate.gyro_bias;
                        push(0, time, expected - sample.yaw_rate_rad_s);
                    }
                    if accelerometer {
                        let left = simulated.left + model.get(Parameter::LateralBias);
                        push(2, time, left - sample.left_m_s2);
                    }
                }
                Sample::Pose(index) => {
                    let [yaw_rate, sideslip] = of.seen[index];
                    if sideslip.is_finite() {
                        push(1, time, simulated.motion.sideslip - sideslip);
                    }
                    if yaw_rate.is_finite() && !gyro {
                        push(0, time, simulated.motion.yaw_rate - yaw_rate);
                    }
                }
            }
        }
        if let Some(scale) = of.scale {
            let error = model.get(Parameter::GyroScale) - scale.value;
            errors.push(((SCALE, f64::MAX), error / scale.deviation));
        }
        Some(errors)
    }

    /// The cost, whatever the sizes are. None where the model is not defined.
    fn cost(&self, u: &[f64]) -> Option<Cost> {
        let errors = Simulated {
            sizes: [1.0; 3],
            ..*self
        };
        let errors = errors.placed(u)?;
        let blocks = self.of.blocks();
        let sum = |number: usize| -> f64 {
            let of_output = errors.iter().filter(|((output, _), _)| *output == number);
            of_output.map(|(_, error)| error * error).sum()
        };
        // An output that is not measured has no errors.
        let size = |sum: f64| {
            if sum > 0.0 {
                f64::sqrt(sum / blocks)
            } else {
                1.0
            }
        };
        let sizes: [f64; 3] = core::array::from_fn(|output| size(sum(output)));
        let products: f64 = sizes.iter().map(|size| size.ln()).sum();
        let prior: f64 = u.iter().map(|u| u * u).sum();
        let value = blocks * products + 0.5 * (sum(SCALE) + prior);
        value.is_finite().then_some(Cost {
            value,
            sizes,
            errors,
        })
    }

    /// Gradient and curvature of the cost, without the second derivatives of the errors; before them, the
    /// curvature of the squares of the errors over their sizes, without what the logarithms take off it.
    fn slopes(&self, u: &[f64], cost: &Cost) -> Option<(DMatrix<f64>, DVector<f64>, DMatrix<f64>)> {
        let weighed = Simulated {
            sizes: cost.sizes,
            ..*self
        };
        let jacobian = weighed.jacobian(u)?;
        let squares = jacobian.tr_mul(&jacobian);
        let mut sums = DMatrix::zeros(u.len(), SCALE + 1);
        for (row, ((output, _), error)) in jacobian.row_iter().zip(&cost.errors) {
            let size = cost.sizes.get(*output).copied().unwrap_or(1.0);
            let mut sum = sums.column_mut(*output);
            sum.axpy(error / size, &row.transpose(), 1.0);
        }
        let gradient = DVector::from_column_slice(u) + sums.column_sum();
        let outputs = sums.columns(0, SCALE);
        let curvature = &squares - outputs * outputs.transpose() * (2.0 / self.of.blocks());
        Some((squares, gradient, curvature))
    }

    /// From `u` to the minimum by Newton's steps, damped where the cost would not fall, until one is below
    /// [`SETTLED`].
    fn minimise(&self, u: &[f64]) -> Option<Minimum> {
        let mut u = DVector::from_column_slice(u);
        let mut cost = self.cost(u.as_slice())?;
        let mut damping = DAMPING;
        let mut step = 1;
        loop {
            let (squares, gradient, curvature) = self.slopes(u.as_slice(), &cost)?;
            let diagonal = squares.diagonal();
            // None where the cost falls nowhere.
            let moved = loop {
                let damped = &curvature + DMatrix::from_diagonal(&(&diagonal * damping));
                let step = damped.cholesky().map(|factors| factors.solve(&gradient));
                if let Some(step) = step {
                    let next = &u - &step;
                    let there = self.cost(next.as_slice());
                    if let Some(there) = there.filter(|there| there.value < cost.value) {
                        (u, cost) = (next, there);
                        damping *= 0.1;
                        break Some(step.component_mul(&diagonal.map(f64::sqrt)).amax());
                    }
                }
                damping = (10.0 * damping).max(1e-4);
                if damping > MOST_DAMPING {
                    break None;
                }
            };
            let moved = moved.filter(|moved| *moved >= SETTLED);
            if moved.is_none() || step == STEPS {
                let variances = squares.cholesky()?.inverse().diagonal();
                return Some(Minimum {
                    u: u.as_slice().to_vec(),
                    deviations: variances.iter().map(|one| one.sqrt()).collect(),
                });
            }
            step += 1;
        }
    }
}

/// The cost at a point: minus the logarithm of the posterior density, but for a constant.
struct Cost {
    value: f64,
    /// With these, the squares of an output's errors sum up to the number of blocks: the root mean square
    /// times the square root of the samples in a block.
    sizes: [f64; 3],
    /// The errors themselves, each with its place.
    errors: Vec<(Place, f64)>,
}

/// From one start to its minimum: the coordinates after each run of the filter.
type Way = Vec<Vec<f64>>;

/// Where the cost is least.
struct Minimum {
    u: Vec<f64>,
    /// Standard deviations near there.
    deviations: Vec<f64>,
}

impl Minimum {
    /// The distance of another point, in standard deviations of the coordinate that differs most.
    fn distance(&self, other: &[f64]) -> f64 {
        let differences = self.u.iter().zip(other).zip(&self.deviations);
        let differences = differences.map(|((u, other), deviation)| (u - other).abs() / deviation);
        differences.fold(0.0, f64::max)
    }
}

impl Task<'_> {
    /// The values that simulate the drive best, from several starts. `noise` is reported as that of
    /// the sensors; of the filter only the speed and the biases are used.
    pub(super) fn fit_simulation(
        &self,
        frames: ServoFrames,
        noise: Option<NoiseLevels>,
    ) -> Result<Fit> {
        let poses = &self.data.poses;
        let seen = poses.iter().map(|pose| {
            let seen = data::seen(poses, pose.time_s);
            seen.map_or([f64::NAN; 2], |seen| [seen.yaw_rate, seen.sideslip])
        });
        let scale = self.settings.parameters.contains(&Parameter::GyroScale);
        let scale = scale.then(|| GyroScale::of(self.data, self.spans));
        let simulations = Simulations {
            task: self,
            frames,
            servo: frames.of(&self.data.servo),
            noise: NoiseLevels::loose(&self.start.vehicle()),
            scale: scale.flatten(),
            seen: seen.collect(),
            measures: [Channel::YawRate, Channel::Left].map(|one| self.data.measures(one)),
        };
        let mut best: Option<(f64, Fit)> = None;
        let mut starts: Vec<Vec<f64>> = Vec::new();
        for factors in STARTS {
            let start = simulations.moved(factors);
            if !starts.contains(&start) {
                starts.push(start);
            }
        }
        let mut last = self.diverged(&vec![0.0; self.settings.parameters.len()]);
        let mut ways: Vec<Way> = Vec::new();
        for start in starts {
            match simulations.descend(start, &mut ways) {
                Ok(None) => {}
                Ok(Some((cost, fit))) => {
                    if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                        best = Some((cost, fit));
                    }
                }
                Err(error) => last = error,
            }
        }
        let (_, fit) = best.ok_or(last)?;
        Ok(Fit {
            noise: noise.unwrap_or(fit.noise),
            ..fit
        })
    }
}

impl Simulations<'_> {
    /// The coordinates of the start, with the vehicle's three parameters changed by `factors`.
    fn moved(&self, factors: [f64; 3]) -> Vec<f64> {
        let task = self.task;
        let coordinate = |parameter: &Parameter| {
            let factor = match parameter {
                Parameter::FrontStiffness => factors[0],
                Parameter::RearStiffness => factors[1],
                Parameter::YawInertia => factors[2],
                Parameter::GyroScale => {
                    let start = task.start.get(*parameter);
                    self.scale.map_or(1.0, |scale| scale.value / start)
                }
                _ => 1.0,
            };
            parameter.prior().coordinate_of_factor(factor)
        };
        task.settings.parameters.iter().map(coordinate).collect()
    }

    /// The number of independent errors of an output.
    fn blocks(&self) -> f64 {
        self.task.spans.iter().map(Span::seconds).sum::<f64>() / BLOCK
    }

    /// From one start to its minimum, with the cost there; none if it joins another of the `ways`. A way
    /// that ends at no minimum is not among these: each start fails by itself.
    fn descend(&self, u: Vec<f64>, ways: &mut Vec<Way>) -> Result<Option<(f64, Fit)>> {
        let task = self.task;
        let at = |u: Vec<f64>| {
            let run = task.run_filter(&self.servo, &u, &self.noise)?;
            let cost = self.with(&run).cost(&u);
            let cost = cost.ok_or_else(|| task.diverged(&u))?;
            Ok((u, run, cost))
        };
        let (mut u, mut run, mut cost) = at(u)?;
        // From minimum to minimum, of which the best counts: on the way the cost may rise.
        let mut best = (cost.value, u.clone());
        let mut way = Way::new();
        let mut rises = 0;
        for _ in 0..FILTER_RUNS {
            let Some(least) = self.with(&run).minimise(&u) else {
                break;
            };
            let mut others = ways.iter().flatten();
            if others.any(|other| least.distance(other) < JOINED) {
                return Ok(None);
            }
            way.push(least.u.clone());
            let Ok(next) = at(least.u) else {
                break;
            };
            (u, run, cost) = next;
            rises += 1;
            if cost.value < best.0 - FALL {
                best = (cost.value, u.clone());
                rises = 0;
            }
            if rises == PATIENCE {
                break;
            }
        }
        // From there on it falls. Where the model describes the car badly, only parts of the way lead down.
        (u, run, cost) = at(best.1)?;
        let mut unsettled = None;
        for _ in 0..FILTER_RUNS {
            let least = self.with(&run).minimise(&u);
            let least = least.ok_or_else(|| task.diverged(&u))?;
            let next = PARTS.iter().find_map(|part| {
                let steps = u.iter().zip(&least.u);
                let next = steps.map(|(u, least)| u + part * (least - u)).collect();
                let next = at(next).ok();
                next.filter(|(.., there)| there.value < cost.value - FALL)
            });
            unsettled = next.is_some().then(|| least.distance(&u));
            let Some(next) = next else {
                break;
            };
            (u, run, cost) = next;
        }
        let times: Vec<f64> = cost.errors.iter().map(|((_, time), _)| *time).collect();
        let weighed = Simulated {
            sizes: cost.sizes,
            ..self.with(&run)
        };
        let spread = spread(&weighed, &u, &times, BLOCK);
        let spread = spread.ok_or_else(|| task.diverged(&u))?;
        let fit = Fit {
            values: task.values(&u),
            u,
            noise: self.noise,
            frames: self.frames,
            spread,
            lead: f64::INFINITY,
            unsettled,
            run,
        };
        ways.push(way);
        Ok(Some((cost.value, fit)))
    }

    /// The simulation with this run of the filter.
    const fn with<'a>(&'a self, run: &'a FilterRun) -> Simulated<'a> {
        Simulated {
            of: self,
            run,
            sizes: [1.0; 3],
        }
    }
}
