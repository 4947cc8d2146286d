//! The fit: gains, parameters and noise levels in turn, until they agree.

use levenberg_marquardt::LevenbergMarquardt;
use nalgebra_levenberg_marquardt::DVector;
use singletrack_control::VehicleParameters;

use super::{
    data::{DriveData, ServoFrames, ServoTarget, Span},
    error::IdentificationError,
    filter::{Passage, pass},
    noise::NoiseLevels,
    parameter::{Parameter, Values},
    predictor::{Problem, Question},
    settings::Settings,
    uncertainty::{Spread, bounds, spread},
};

/// What came of a fit.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) values: Values,
    /// The active parameters as the optimiser sees them.
    pub(super) u: Vec<f64>,
    pub(super) noise: NoiseLevels,
    pub(super) frames: ServoFrames,
    pub(super) passage: Passage,
    pub(super) spread: Spread,
    /// By how much more likely these frames are than the next, as a logarithm; infinite
    /// if they were given.
    pub(super) lead: f64,
    /// How far, in standard deviations, the last turn moved a parameter, if it was not
    /// little enough to stop.
    pub(super) unsettled: Option<f64>,
    /// Evaluations of the prediction errors.
    pub(super) evaluations: usize,
}

/// A drive and what is not estimated of it.
pub(super) struct Task<'a> {
    pub(super) data: &'a DriveData,
    pub(super) spans: &'a [Span],
    pub(super) start: Values,
    pub(super) active: &'a [Parameter],
    pub(super) settings: &'a Settings,
}

/// So often gains and parameters take turns.
const ROUNDS: usize = 12;
/// Evaluations in one turn, over the number of parameters and one.
const PATIENCE: usize = 1;
/// A change that is so small a part of a standard deviation is none.
const SETTLED: f64 = 0.01;

impl Task<'_> {
    /// The vehicle as it is believed at the start.
    pub(super) const fn vehicle(&self) -> VehicleParameters {
        self.start.vehicle()
    }

    pub(super) fn fit(&self) -> Result<Fit, IdentificationError> {
        let candidates = match self.settings.frames {
            Some(frames) => vec![frames],
            None => ServoFrames::ALL.to_vec(),
        };
        let zero = vec![0.0; self.active.len()];
        let noise = if self.settings.estimate_noise {
            self.settings.noise.seen(self.data, self.spans)
        } else {
            self.settings.noise
        };
        let seen = noise;
        // The frames under which the drive is most likely, each with its own noise: with
        // the noise of the start, or with another's, the wrong ones may seem the likelier.
        let mut tried: Vec<(f64, ServoFrames, Vec<f64>)> = Vec::new();
        let mut evaluations = 0;
        let single = candidates.len() == 1;
        for frames in candidates {
            let servo = frames.of(&self.data.servo);
            let mut u = zero.clone();
            let mut noise = noise;
            // A start that is far away shows only when the gains have followed.
            for turn in 0..if single { 2 } else { 3 } {
                if turn == 2 {
                    noise = self.likely(&servo, &u, noise, &seen, 2)?;
                }
                let passage = self.pass(&servo, &u, &noise)?;
                let (next, count) = self.minimise(&servo, &passage, &u, 2 * PATIENCE)?;
                evaluations += count;
                u = next;
            }
            let noise = if single {
                noise
            } else {
                self.likely(&servo, &u, noise, &seen, 1)?
            };
            tried.push((self.pass(&servo, &u, &noise)?.likelihood(), frames, u));
        }
        tried.sort_by(|one, other| other.0.total_cmp(&one.0));
        let lead = match tried.get(..2) {
            Some([first, second]) => first.0 - second.0,
            _ => f64::INFINITY,
        };
        let (_, frames, mut u) = tried
            .into_iter()
            .next()
            .ok_or(IdentificationError::Diverged {
                vehicle: self.vehicle(),
            })?;
        let servo = frames.of(&self.data.servo);
        let mut noise = noise;
        for round in 0..ROUNDS {
            if self.settings.estimate_noise && round < 3 {
                let rounds = if round == 0 { 2 } else { 1 };
                noise = self.likely(&servo, &u, noise, &seen, rounds)?;
            }
            let passage = self.pass(&servo, &u, &noise)?;
            let (next, count) = self.minimise(&servo, &passage, &u, PATIENCE)?;
            evaluations += count;
            let question = self.question(&servo, &passage);
            let spread = spread(&question, &next).ok_or_else(|| self.diverged(&next))?;
            let moved = next
                .iter()
                .zip(&u)
                .zip(&spread.deviations)
                .map(|((next, last), deviation)| (next - last).abs() / deviation)
                .fold(0.0, f64::max);
            u = next;
            let settled = moved < SETTLED && round >= 2;
            if settled || round + 1 == ROUNDS {
                let passage = self.pass(&servo, &u, &noise)?;
                return Ok(Fit {
                    values: self.values(&u),
                    u,
                    noise,
                    frames,
                    passage,
                    spread,
                    lead,
                    unsettled: (!settled).then_some(moved),
                    evaluations,
                });
            }
        }
        Err(self.diverged(&u))
    }

    /// The most likely levels of noise, or those given if they are not to be estimated.
    fn likely(
        &self,
        servo: &[ServoTarget],
        u: &[f64],
        noise: NoiseLevels,
        seen: &NoiseLevels,
        rounds: u32,
    ) -> Result<NoiseLevels, IdentificationError> {
        if !self.settings.estimate_noise {
            return Ok(noise);
        }
        let values = self.values(u);
        let tyres = self.settings.tyres;
        noise
            .most_likely(seen, rounds, |levels| {
                pass(self.data, servo, self.spans, &values, tyres, levels)
            })
            .ok_or_else(|| self.diverged(u))
    }

    /// The smallest standard deviations, with the car as it is at the start.
    pub(super) fn bounds(
        &self,
        frames: ServoFrames,
        noise: &NoiseLevels,
    ) -> Result<Vec<f64>, IdentificationError> {
        let servo = frames.of(&self.data.servo);
        let zero = vec![0.0; self.active.len()];
        let passage = self.pass(&servo, &zero, noise)?;
        let question = self.question(&servo, &passage);
        let bounds = bounds(&question).ok_or_else(|| self.diverged(&zero))?;
        let slopes = self.active.iter();
        let slopes =
            slopes.map(|parameter| parameter.prior().slope(self.start.get(*parameter), 0.0));
        Ok(slopes
            .zip(bounds)
            .map(|(slope, bound)| slope * bound)
            .collect())
    }

    fn question<'b>(&'b self, servo: &'b [ServoTarget], passage: &'b Passage) -> Question<'b> {
        Question {
            data: self.data,
            servo,
            spans: self.spans,
            gains: &passage.gains,
            start: &self.start,
            active: self.active,
            tyres: self.settings.tyres,
        }
    }

    fn values(&self, u: &[f64]) -> Values {
        let mut values = self.start;
        for (parameter, u) in self.active.iter().zip(u) {
            let value = parameter.prior().value(self.start.get(*parameter), *u);
            values = values.with(*parameter, value);
        }
        values
    }

    fn pass(
        &self,
        servo: &[ServoTarget],
        u: &[f64],
        noise: &NoiseLevels,
    ) -> Result<Passage, IdentificationError> {
        pass(
            self.data,
            servo,
            self.spans,
            &self.values(u),
            self.settings.tyres,
            noise,
        )
        .ok_or_else(|| self.diverged(u))
    }

    fn diverged(&self, u: &[f64]) -> IdentificationError {
        IdentificationError::Diverged {
            vehicle: self.values(u).vehicle(),
        }
    }

    fn minimise(
        &self,
        servo: &[ServoTarget],
        passage: &Passage,
        u: &[f64],
        patience: usize,
    ) -> Result<(Vec<f64>, usize), IdentificationError> {
        let problem = Problem {
            question: self.question(servo, passage),
            u: DVector::from_column_slice(u),
        };
        let (problem, report) = LevenbergMarquardt::new()
            .with_ftol(1e-7)
            .with_xtol(1e-5)
            .with_gtol(1e-7)
            .with_stepbound(1.0)
            .with_patience(patience)
            .minimize(problem);
        let u = problem.u.as_slice().to_vec();
        // Out of patience is no failure: it goes on from there with new gains.
        let failed = matches!(
            report.termination,
            levenberg_marquardt::TerminationReason::User(_)
                | levenberg_marquardt::TerminationReason::Numerical(_)
        );
        if failed && !u.iter().all(|u| u.is_finite()) {
            return Err(self.diverged(&u));
        }
        Ok((u, report.number_of_evaluations))
    }
}
