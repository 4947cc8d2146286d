//! A least-squares problem in the coordinates of the optimiser, with the prior of every parameter.

use nalgebra::{DMatrix, DVector};
use num_dual::DualSVec64;

use super::parameter::COUNT;
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

    /// As [`Self::residuals`], for an optimiser, which takes a step out of the model back. `count` is
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

    /// The same with `N` derivatives, of which the first `u.len()` are used.
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
