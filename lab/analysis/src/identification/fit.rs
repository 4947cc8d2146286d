//! The fit: gains, parameters and noise levels in turn, until they converge; and its estimates with their
//! covariance and confidence intervals.

use nalgebra::{DMatrix, DVector};

use super::{
    data::{Drive, DriveData, ServoFrames, ServoTarget, Span},
    error::{IdentificationError, Result},
    filter::{FilterRun, run_filter},
    least_squares::{Problem, minimise},
    parameter::{Parameter, Prior, Values},
    predictor::Prediction,
    settings::{NoiseLevels, Settings},
};

/// The result of a fit.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) values: Values,
    /// The active parameters in the coordinates of the optimiser.
    pub(super) u: Vec<f64>,
    pub(super) noise: NoiseLevels,
    pub(super) frames: ServoFrames,
    pub(super) run: FilterRun,
    pub(super) spread: Spread,
    /// The log-likelihood above that of the next candidate for `frames`; infinite if they
    /// were given.
    pub(super) lead: f64,
    /// The largest change of a parameter in the last round, in standard deviations, if the
    /// fit has not converged.
    pub(super) unsettled: Option<f64>,
}

/// The spread of the estimates in the coordinates of the optimiser.
#[derive(Clone, Debug)]
pub(super) struct Spread {
    /// Covariance for white prediction errors: the inverse of the information matrix.
    pub(super) white: DMatrix<f64>,
    /// Covariance for errors that are correlated within [`BLOCK`].
    robust: DMatrix<f64>,
    /// Standard deviation of each parameter by the wider of the two.
    pub(super) deviations: Vec<f64>,
}

/// An estimated parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The parameter.
    pub parameter: Parameter,
    /// The start value of the fit, in the parameter's unit.
    pub start: f64,
    /// The estimate.
    pub value: f64,
    /// Its standard deviation.
    pub standard_deviation: f64,
    /// The 95 % confidence interval.
    pub interval: [f64; 2],
    /// Standard deviation if the prediction errors are white.
    pub white_deviation: f64,
    /// Standard deviation if they are correlated over up to half a second.
    pub robust_deviation: f64,
    /// Whether the estimate is at the bound of its range.
    pub at_bound: bool,
}

/// A drive, the start values, and the choices of the fit.
pub(super) struct Task<'a> {
    pub(super) data: &'a DriveData,
    pub(super) spans: &'a [Span],
    pub(super) start: Values,
    pub(super) settings: &'a Settings,
}

/// The largest number of rounds. A round runs the filter and then the optimiser.
const ROUNDS: usize = 12;
/// The smallest number of rounds.
const LEAST_ROUNDS: usize = 3;
/// Evaluations in one run of the optimiser, over the number of parameters plus one.
const PATIENCE: usize = 1;
/// The fit has converged below this change, in standard deviations.
const SETTLED: f64 = 0.01;
/// So has one that goes to and fro by less: between two delays at which two samples change places.
const RETURNS: f64 = 0.25;

/// Prediction errors farther apart than this count as independent, in s.
const BLOCK: f64 = 0.5;

/// Half the width of a 95 % confidence interval, in standard deviations.
const NINETY_FIVE: f64 = 1.96;

/// The least standard deviation of a vehicle's parameter, over its value. A gyro that vibrates is in the
/// fitted motion too, not in its error alone: it moves the estimates of the simulated car by 0.2 %.
const FLOOR: f64 = 1.5e-3;

impl Task<'_> {
    pub(super) fn fit(&self) -> Result<Fit> {
        let candidates = match self.settings.frames {
            Some(frames) => vec![frames],
            None => ServoFrames::ALL.to_vec(),
        };
        let zero = vec![0.0; self.settings.parameters.len()];
        let mut noise = self.settings.noise;
        if self.settings.estimate_noise {
            noise = noise.with_measured_sensors(self.data, self.spans);
        }
        let sampled = noise;
        // The most likely frames. Each candidate has its own noise levels: with those of the
        // start, or of another candidate, wrong frames may have the larger likelihood.
        let mut tried: Vec<(f64, ServoFrames, Vec<f64>)> = Vec::new();
        let single = candidates.len() == 1;
        for frames in candidates {
            let servo = frames.of(&self.data.servo);
            let mut u = zero.clone();
            let mut noise = noise;
            // With distant start values the gains need more than one round.
            for round in 0..if single { 2 } else { 3 } {
                if round == 2 {
                    noise = self.likely_noise(&servo, &u, noise, &sampled, 2)?;
                }
                let run = self.run_filter(&servo, &u, &noise)?;
                u = self.minimise(&servo, &run, &u, 2 * PATIENCE)?;
            }
            let noise = if single {
                noise
            } else {
                self.likely_noise(&servo, &u, noise, &sampled, 1)?
            };
            tried.push((self.run_filter(&servo, &u, &noise)?.likelihood(), frames, u));
        }
        tried.sort_by(|one, other| other.0.total_cmp(&one.0));
        let lead = match tried.get(..2) {
            Some([first, second]) => first.0 - second.0,
            _ => f64::INFINITY,
        };
        let Some((_, frames, mut u)) = tried.into_iter().next() else {
            return Err(self.diverged(&zero));
        };
        let servo = frames.of(&self.data.servo);
        let mut before = u.clone();
        for round in 0..ROUNDS {
            if self.settings.estimate_noise && round < LEAST_ROUNDS {
                let rounds = if round == 0 { 2 } else { 1 };
                noise = self.likely_noise(&servo, &u, noise, &sampled, rounds)?;
            }
            let run = self.run_filter(&servo, &u, &noise)?;
            let next = self.minimise(&servo, &run, &u, PATIENCE)?;
            if round < LEAST_ROUNDS - 1 {
                before = core::mem::replace(&mut u, next);
                continue;
            }
            let prediction = self.prediction(&servo, &run);
            let spread = spread(&prediction, &next, &prediction.times(), BLOCK)
                .ok_or_else(|| self.diverged(&next))?;
            let moved_from = |last: &[f64]| {
                let steps = next.iter().zip(last).zip(&spread.deviations);
                steps
                    .map(|((next, last), deviation)| (next - last).abs() / deviation)
                    .fold(0.0, f64::max)
            };
            let moved = moved_from(&u);
            let returns = moved < RETURNS && moved_from(&before) < SETTLED;
            before = core::mem::replace(&mut u, next);
            let settled = moved < SETTLED || returns;
            if settled || round + 1 == ROUNDS {
                let run = self.run_filter(&servo, &u, &noise)?;
                return Ok(Fit {
                    values: self.values(&u),
                    u,
                    noise,
                    frames,
                    run,
                    spread,
                    lead,
                    unsettled: (!settled).then_some(moved),
                });
            }
        }
        Err(self.diverged(&u))
    }

    /// The most likely noise levels, or the given ones if they are not estimated.
    fn likely_noise(
        &self,
        servo: &[ServoTarget],
        u: &[f64],
        noise: NoiseLevels,
        sampled: &NoiseLevels,
        rounds: u32,
    ) -> Result<NoiseLevels> {
        if !self.settings.estimate_noise {
            return Ok(noise);
        }
        let values = self.values(u);
        let run = |levels: &_| run_filter(self.drive(servo), &values, self.settings, levels);
        let likely = noise.most_likely(sampled, rounds, run);
        likely.ok_or_else(|| self.diverged(u))
    }

    /// The smallest standard deviations of estimates for the car of the start values.
    pub(super) fn bounds(&self, frames: ServoFrames, noise: &NoiseLevels) -> Result<Vec<f64>> {
        let servo = frames.of(&self.data.servo);
        let zero = vec![0.0; self.settings.parameters.len()];
        let run = self.run_filter(&servo, &zero, noise)?;
        let prediction = self.prediction(&servo, &run);
        let bounds = bounds(&prediction).ok_or_else(|| self.diverged(&zero))?;
        let parameters = self.settings.parameters.iter();
        let bounds = parameters.zip(bounds).map(|(parameter, bound)| {
            parameter.prior().slope(self.start.get(*parameter), 0.0) * bound
        });
        Ok(bounds.collect())
    }

    pub(super) const fn drive<'b>(&'b self, servo: &'b [ServoTarget]) -> Drive<'b> {
        Drive {
            data: self.data,
            servo,
            spans: self.spans,
        }
    }

    fn prediction<'b>(&'b self, servo: &'b [ServoTarget], run: &'b FilterRun) -> Prediction<'b> {
        Prediction {
            drive: self.drive(servo),
            gains: &run.gains,
            start: &self.start,
            settings: self.settings,
        }
    }

    pub(super) fn values(&self, u: &[f64]) -> Values {
        let moved = self.start.moved(&self.settings.parameters, u);
        let moved = Parameter::ALL.into_iter().zip(moved);
        moved.fold(self.start, |values, (parameter, value)| {
            values.with(parameter, value)
        })
    }

    pub(super) fn run_filter(
        &self,
        servo: &[ServoTarget],
        u: &[f64],
        noise: &NoiseLevels,
    ) -> Result<FilterRun> {
        run_filter(self.drive(servo), &self.values(u), self.settings, noise)
            .ok_or_else(|| self.diverged(u))
    }

    pub(super) fn diverged(&self, u: &[f64]) -> IdentificationError {
        IdentificationError::Diverged(self.values(u).vehicle())
    }

    fn minimise(
        &self,
        servo: &[ServoTarget],
        run: &FilterRun,
        u: &[f64],
        patience: usize,
    ) -> Result<Vec<f64>> {
        let prediction = self.prediction(servo, run);
        let count = prediction.rows() + u.len();
        // Running out of evaluations is no failure: the next round continues with new gains.
        let u = minimise(
            u,
            |u| prediction.residuals_or_outside(u, count),
            |u| prediction.jacobian(u),
            patience * (u.len() + 1),
        );
        if !u.iter().all(|u| u.is_finite()) {
            return Err(self.diverged(&u));
        }
        Ok(u)
    }
}

/// Standard deviations at u = 0 from the information matrix alone, without the prior.
fn bounds(prediction: &Prediction<'_>) -> Option<Vec<f64>> {
    let count = prediction.settings.parameters.len();
    let jacobian = prediction.jacobian(&vec![0.0; count])?;
    let rows = jacobian.rows(0, jacobian.nrows() - count);
    let covariance = rows.tr_mul(&rows).cholesky()?.inverse();
    Some(covariance.diagonal().iter().map(|x| x.sqrt()).collect())
}

/// The spread around `u`. `times` are those of the errors, in s; those farther apart than `block` count
/// as independent. None where the model is not defined, or where the drive does not determine a
/// combination of the parameters.
pub(super) fn spread(
    problem: &impl Problem,
    u: &[f64],
    times: &[f64],
    block: f64,
) -> Option<Spread> {
    let jacobian = problem.jacobian(u)?;
    let residuals = problem.residuals(u)?;
    let information = jacobian.tr_mul(&jacobian);
    let white = information.cholesky()?.inverse();
    let count = jacobian.ncols();
    let rows = residuals.len() - count;
    // The sums of the scores over blocks of time.
    let mut blocks: std::collections::BTreeMap<i64, DVector<f64>> =
        std::collections::BTreeMap::new();
    for (row, time) in times.iter().enumerate().take(rows) {
        let residual = residuals[row];
        if residual != 0.0 {
            let score = blocks
                .entry((time / block).floor() as i64)
                .or_insert_with(|| DVector::zeros(count));
            for column in 0..count {
                score[column] += jacobian[(row, column)] * residual;
            }
        }
    }
    // The prior counts once.
    let mut meat = DMatrix::identity(count, count);
    for score in blocks.values() {
        meat += score * score.transpose();
    }
    // With few blocks the sample variance is too small.
    let used = blocks.len() as f64;
    let few = used / (used - count as f64).max(1.0);
    let robust = &white * meat * few * &white;
    let deviations = (0..count)
        .map(|index| white[(index, index)].max(robust[(index, index)]).sqrt())
        .collect();
    Some(Spread {
        white,
        robust,
        deviations,
    })
}

/// The estimates of a fit, in the order of the settings.
pub(super) fn estimates(start: &Values, settings: &Settings, fit: &Fit) -> Vec<Estimate> {
    let active = settings.parameters.iter().zip(&fit.u);
    active
        .enumerate()
        .map(|(index, (parameter, u))| {
            let prior = parameter.prior();
            let start = start.get(*parameter);
            let slope = prior.slope(start, *u).abs();
            let spread = &fit.spread;
            let deviation = spread.deviations[index];
            let value = prior.value(start, *u);
            let deviation = if Parameter::NUISANCE.contains(parameter) {
                deviation
            } else {
                deviation.hypot(FLOOR * value.abs() / slope)
            };
            let reach = NINETY_FIVE * deviation;
            Estimate {
                parameter: *parameter,
                start,
                value,
                standard_deviation: slope * deviation,
                interval: [u - reach, u + reach].map(|u| prior.value(start, u)),
                white_deviation: slope * spread.white[(index, index)].sqrt(),
                robust_deviation: slope * spread.robust[(index, index)].sqrt(),
                at_bound: Prior::is_at_bound(*u),
            }
        })
        .collect()
}

/// The correlations of the estimates, in the same order.
pub(super) fn correlation(fit: &Fit) -> DMatrix<f64> {
    let white = &fit.spread.white;
    DMatrix::from_fn(white.nrows(), white.ncols(), |row, column| {
        white[(row, column)] / (white[(row, row)] * white[(column, column)]).sqrt()
    })
}
