//! The choices of an identification, and its least-squares problem in the coordinates of the
//! optimiser, with the prior of every parameter.

use nalgebra::{DMatrix, DVector};
use num_dual::DualSVec64;
use singletrack_control::{SlipAngles, Tyres, words};

use super::{
    data::ServoFrames,
    noise::NoiseLevels,
    parameter::{COUNT, Parameter},
};
use crate::dual::Dual;

/// The value of every error, in standard deviations, where the model is not defined: worse
/// than any fit.
const OUTSIDE: f64 = 1e4;

/// Errors that depend on the parameters.
pub(super) trait Problem {
    /// The errors over their standard deviations. None where the model is not defined.
    fn errors<D: Dual>(&self, u: &[D]) -> Option<Vec<D>>;

    /// The errors, followed by those of the prior.
    fn residuals(&self, u: &[f64]) -> Option<DVector<f64>> {
        let mut errors = self.errors(u)?;
        errors.extend_from_slice(u);
        let finite = errors.iter().all(|error| error.is_finite());
        finite.then(|| DVector::from_vec(errors))
    }

    /// [`Self::residuals`] for an optimiser, which takes a step out of the model back. `count` is
    /// their number.
    fn residuals_or_outside(&self, u: &[f64], count: usize) -> DVector<f64> {
        self.residuals(u)
            .unwrap_or_else(|| DVector::from_element(count, OUTSIDE))
    }

    /// The derivatives of [`Self::residuals`] by `u`.
    fn jacobian(&self, u: &[f64]) -> Option<DMatrix<f64>> {
        if u.len() <= 9 {
            self.jacobian_of::<9>(u)
        } else {
            self.jacobian_of::<COUNT>(u)
        }
    }

    /// The Jacobian by `N` derivatives, of which the first `u.len()` are used.
    fn jacobian_of<const N: usize>(&self, u: &[f64]) -> Option<DMatrix<f64>> {
        let seeds: Vec<_> = u
            .iter()
            .enumerate()
            .map(|(index, u)| DualSVec64::<N>::from(*u).derivative(index))
            .collect();
        let errors = self.errors(&seeds)?;
        let mut jacobian = DMatrix::zeros(errors.len() + u.len(), u.len());
        for (row, error) in errors.iter().enumerate() {
            if let Some(gradient) = &error.eps.0 {
                for (column, value) in gradient.iter().take(u.len()).enumerate() {
                    jacobian[(row, column)] = *value;
                }
            }
        }
        for column in 0..u.len() {
            jacobian[(errors.len() + column, column)] = 1.0;
        }
        let is_finite = jacobian.iter().all(|value| value.is_finite());
        is_finite.then_some(jacobian)
    }
}

words! {
    /// What a fit minimises.
    pub enum Criterion {
        /// The errors of the prediction of each sample from those before it: the most exact, if the
        /// model is right.
        Prediction = "prediction",
        /// The errors of the model alone, without a correction since the stretch began: what a
        /// simulation of the car needs, and robust against behaviour that the model lacks.
        Simulation = "simulation",
    }
}

/// The parameters, model and noise levels of an identification.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The parameters to estimate. The others keep their start values, those of
    /// [`Parameter::NUISANCE`] included.
    pub parameters: Vec<Parameter>,
    /// The force curve of the tyres.
    pub tyres: Tyres,
    /// The slip angles of the model.
    pub slip_angles: SlipAngles,
    /// Dead time and lag of the steering (s) where the fit starts, and about which their priors are; none
    /// for those of [`Values::of`](super::Values::of).
    pub steering: Option<[f64; 2]>,
    /// The board's periods that begin a servo pulse; none to estimate them.
    pub frames: Option<ServoFrames>,
    /// Noise levels, or their start values if they are estimated.
    pub noise: NoiseLevels,
    /// Estimates the noise levels too.
    pub estimate_noise: bool,
    /// What is minimised; none for the prediction, and for the simulation where forces that the model does
    /// not explain make the prediction's parameters simulate much worse.
    pub criterion: Option<Criterion>,
    /// The smallest speed that is used, in m/s: at lower speeds the tyres hardly slip.
    pub least_speed: f64,
}

impl Default for Settings {
    /// The paper's three parameters and those that must be estimated jointly with them.
    fn default() -> Self {
        Self::of(&Parameter::VEHICLE)
    }
}

impl Settings {
    /// These parameters and [`Parameter::NUISANCE`], which must be estimated jointly.
    pub fn of(parameters: &[Parameter]) -> Self {
        let mut all = Vec::new();
        for parameter in parameters.iter().chain(&Parameter::NUISANCE) {
            if !all.contains(parameter) {
                all.push(*parameter);
            }
        }
        Self {
            parameters: all,
            tyres: Tyres::default(),
            slip_angles: SlipAngles::default(),
            steering: None,
            frames: None,
            noise: NoiseLevels::usual(),
            estimate_noise: true,
            criterion: None,
            least_speed: 0.5,
        }
    }
}
