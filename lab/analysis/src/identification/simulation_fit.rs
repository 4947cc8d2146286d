//! The fit that minimises the errors of a simulation.
//!
//! A prediction corrects the model at each sample. Where the car has more effects than the model, the
//! corrections take them up, and the parameters that predict the next sample best may simulate badly.
//! This fit leaves yaw rate and sideslip of the model alone for the whole stretch, as
//! [`super::simulation`] does, and minimises the product of the root mean squares of its errors: each
//! output is divided by that of the last round. Its errors are correlated over seconds: all of an output
//! within [`BLOCK`] count as one beside the prior.

use super::{
    data::{self, Channel, GyroScale, ServoFrames, ServoTarget, Span},
    error::IdentificationError,
    fit::{Fit, Task},
    least_squares::minimise,
    model::Model,
    noise::NoiseLevels,
    parameter::Parameter,
    problem::Problem,
    simulation::{Inputs, Sample},
    uncertainty::spread,
};
use crate::dual::Dual;

/// Errors of the simulation farther apart than this count as independent, in s.
const BLOCK: f64 = 2.0;
/// The largest number of rounds. A round weighs the outputs and then runs the optimiser.
const ROUNDS: usize = 25;
/// The filter runs in the first rounds alone. Its speed and biases hardly depend on the parameters, but
/// that little can make the rounds swing.
const FILTER_ROUNDS: usize = 4;
/// The fit has converged below this change, in standard deviations.
const SETTLED: f64 = 0.05;
/// Where further fits start, by factors on stiffness in front, stiffness in the rear and yaw inertia.
const STARTS: [[f64; 3]; 4] = [
    [1.0, 1.0, 1.0],
    [0.5, 0.5, 1.0],
    [2.0, 2.0, 1.0],
    [0.6, 1.6, 2.0],
];

/// A simulation with its errors.
struct Simulated<'a> {
    task: &'a Task<'a>,
    inputs: Inputs<'a>,
    scale: Option<GyroScale>,
    /// What the errors of yaw rate, sideslip and acceleration are divided by, see
    /// [`Self::measured_sizes`].
    sizes: [f64; 3],
    /// Yaw rate (rad/s) and sideslip (rad) of the cameras at each pose; NaN without enough poses.
    seen: &'a [[f64; 2]],
    /// Whether a gyro measures the yaw rate, and an accelerometer the acceleration to the left.
    measures: [bool; 2],
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
        let Task { start, active, .. } = self.task;
        let model = Model::new(
            start,
            start.moved(active, u),
            self.task.settings.structure(),
        );
        let mut errors = Vec::with_capacity(3 * self.inputs.data.poses.len());
        let mut push = |output: usize, time: f64, error: D| {
            let size = self.sizes.get(output).copied().unwrap_or(1.0);
            errors.push(((output, time), error / size));
        };
        for simulated in self.inputs.simulate(&model)? {
            let time = simulated.time_s;
            match simulated.sample {
                Sample::Inertial(track) => {
                    let sample = self.inputs.data.inertial.get(track.inertial)?;
                    let [gyro, accelerometer] = self.measures;
                    if gyro {
                        let gyro = simulated.motion.yaw_rate * model.get(Parameter::GyroScale);
                        let expected = gyro + track.estimate.gyro_bias;
                        push(0, time, expected - sample.yaw_rate_rad_s);
                    }
                    if accelerometer {
                        let left = simulated.left + model.get(Parameter::LateralBias);
                        push(2, time, left - sample.left_m_s2);
                    }
                }
                Sample::Pose(index) => {
                    let [yaw_rate, sideslip] = *self.seen.get(index)?;
                    if sideslip.is_finite() {
                        push(1, time, simulated.motion.sideslip - sideslip);
                    }
                    if yaw_rate.is_finite() && !self.measures[0] {
                        push(0, time, simulated.motion.yaw_rate - yaw_rate);
                    }
                }
            }
        }
        if let Some(scale) = self.scale {
            let error = model.get(Parameter::GyroScale) - scale.value;
            errors.push(((SCALE, f64::MAX), error / scale.deviation));
        }
        Some(errors)
    }

    /// The sizes with which the squares of an output's errors sum up to the number of blocks: the root
    /// mean square times the square root of the samples in a block.
    fn measured_sizes(&self, u: &[f64]) -> Option<[f64; 3]> {
        let mut sums = [0.0; 3];
        for ((output, _), error) in self.placed(u)? {
            if let Some(sum) = sums.get_mut(output) {
                *sum += error * error;
            }
        }
        let blocks = self.task.blocks();
        let mut sizes = self.sizes;
        for (size, sum) in sizes.iter_mut().zip(sums) {
            // An output that is not measured has no errors.
            if sum > 0.0 {
                *size *= f64::sqrt(sum / blocks);
            }
        }
        let normal = sizes.iter().all(|size: &f64| size.is_normal());
        normal.then_some(sizes)
    }
}

impl Task<'_> {
    /// The values that simulate the drive best, from several starts. `noise` is reported as that of
    /// the sensors; of the filter only the speed and the biases are used.
    pub(super) fn fit_simulation(
        &self,
        frames: ServoFrames,
        noise: Option<NoiseLevels>,
    ) -> Result<Fit, IdentificationError> {
        let loose = NoiseLevels::loose(&self.vehicle());
        let servo = frames.of(&self.data.servo);
        let poses = &self.data.poses;
        let seen = poses.iter().map(|pose| {
            let seen = data::seen(poses, pose.time_s);
            seen.map_or([f64::NAN; 2], |seen| [seen.yaw_rate, seen.sideslip])
        });
        let seen: Vec<[f64; 2]> = seen.collect();
        let scale = self.active.contains(&Parameter::GyroScale);
        let scale = scale
            .then(|| GyroScale::of(self.data, self.spans))
            .flatten();
        let mut best: Option<(f64, Fit)> = None;
        let mut starts: Vec<Vec<f64>> = Vec::new();
        for factors in STARTS {
            let start = self.moved(factors, scale);
            if !starts.contains(&start) {
                starts.push(start);
            }
        }
        let mut last = self.diverged(&vec![0.0; self.active.len()]);
        for start in starts {
            match self.descend(start, &servo, &seen, scale, &loose) {
                Ok((cost, fit)) => {
                    let better = best.as_ref().is_none_or(|(least, _)| cost < *least);
                    if better {
                        best = Some((cost, Fit { frames, ..fit }));
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

    /// The coordinates of the start, with the vehicle's three parameters changed by `factors`.
    fn moved(&self, factors: [f64; 3], scale: Option<GyroScale>) -> Vec<f64> {
        let coordinate = |parameter: &Parameter| {
            let factor = match parameter {
                Parameter::FrontStiffness => factors[0],
                Parameter::RearStiffness => factors[1],
                Parameter::YawInertia => factors[2],
                Parameter::GyroScale => {
                    scale.map_or(1.0, |scale| scale.value / self.start.get(*parameter))
                }
                _ => 1.0,
            };
            parameter.prior().coordinate_of_factor(factor)
        };
        self.active.iter().map(coordinate).collect()
    }

    /// The number of independent errors of an output.
    fn blocks(&self) -> f64 {
        self.spans.iter().map(Span::seconds).sum::<f64>() / BLOCK
    }

    /// From one start to its minimum. The cost is minus the logarithm of the posterior density, but for a
    /// constant.
    fn descend(
        &self,
        mut u: Vec<f64>,
        servo: &[ServoTarget],
        seen: &[[f64; 2]],
        scale: Option<GyroScale>,
        noise: &NoiseLevels,
    ) -> Result<(f64, Fit), IdentificationError> {
        let mut sizes = None;
        let mut moved = f64::INFINITY;
        let mut run = self.run_filter(servo, &u, noise)?;
        for round in 1.. {
            if (2..=FILTER_ROUNDS).contains(&round) {
                run = self.run_filter(servo, &u, noise)?;
            }
            let mut problem = Simulated {
                task: self,
                inputs: Inputs {
                    data: self.data,
                    servo,
                    spans: self.spans,
                    run: &run,
                },
                scale,
                sizes: sizes.unwrap_or([1.0; 3]),
                seen,
                measures: [Channel::YawRate, Channel::Left].map(|one| self.data.measures(one)),
            };
            problem.sizes = problem
                .measured_sizes(&u)
                .ok_or_else(|| self.diverged(&u))?;
            sizes = Some(problem.sizes);
            if moved < SETTLED || round > ROUNDS {
                let placed = problem.placed(&u).ok_or_else(|| self.diverged(&u))?;
                let times: Vec<f64> = placed.iter().map(|((_, time), _)| *time).collect();
                let spread =
                    spread(&problem, &u, &times, BLOCK).ok_or_else(|| self.diverged(&u))?;
                let errors: f64 = problem.sizes.iter().map(|size| size.ln()).sum();
                let prior: f64 = u.iter().map(|u| u * u).sum();
                let cost = self.blocks() * errors + 0.5 * prior;
                let fit = Fit {
                    values: self.values(&u),
                    u,
                    noise: *noise,
                    frames: ServoFrames::Every,
                    spread,
                    lead: f64::INFINITY,
                    unsettled: (moved >= SETTLED).then_some(moved),
                    run,
                };
                return Ok((cost, fit));
            }
            let residuals = problem.residuals(&u);
            let rows = residuals.ok_or_else(|| self.diverged(&u))?.len();
            let next = minimise(
                &u,
                |u| problem.residuals_or_outside(u, rows),
                |u| problem.jacobian(u),
                2 * (u.len() + 1),
            );
            let jacobian = problem.jacobian(&next);
            let jacobian = jacobian.ok_or_else(|| self.diverged(&u))?;
            let information = jacobian.tr_mul(&jacobian).diagonal();
            let moves = next.iter().zip(&u).zip(information.iter());
            moved = moves
                .map(|((next, last), information)| (next - last).abs() * information.sqrt())
                .fold(0.0, f64::max);
            u = next;
        }
        Err(self.diverged(&u))
    }
}
