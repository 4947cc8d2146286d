//! Least squares, with the prior of every parameter, in the coordinates of the optimiser: the method of
//! Levenberg and Marquardt, with a trust region.
//!
//! J. J. Moré, "The Levenberg-Marquardt algorithm: implementation and theory", Numerical
//! Analysis, Lecture Notes in Mathematics 630, Springer, 1978. The steps come from the normal
//! equations: the residuals contain a prior of every parameter with a deviation of one, which
//! keeps the equations well-conditioned.

use nalgebra::{Cholesky, DMatrix, DVector};
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

/// Relative reduction of the sum of squares, actual and predicted, at which it has converged.
const REDUCTION: f64 = 1e-7;
/// Size of the trust region over that of the parameters, at which it has converged.
const STEP: f64 = 1e-5;
/// Cosine of the angle between the residuals and the columns of the Jacobian, at which it has
/// converged.
const COSINE: f64 = 1e-7;
/// The step's length may be off the size of the trust region by this, relatively.
const TOLERANCE: f64 = 0.1;
/// Attempts to find a step of that length.
const ATTEMPTS: usize = 10;

/// Where the sum of the squares of the residuals is least, as far as it was found: it ends when it has
/// converged, when it has evaluated the residuals `limit` times, or where there is no Jacobian.
pub(super) fn minimise(
    start: &[f64],
    residuals: impl Fn(&[f64]) -> DVector<f64>,
    jacobian: impl Fn(&[f64]) -> Option<DMatrix<f64>>,
    limit: usize,
) -> Vec<f64> {
    let mut u = DVector::from_column_slice(start);
    let mut errors = residuals(start);
    let mut evaluations = 1;
    let mut norm = errors.norm();
    let mut region = None;
    let mut damping = 0.0;
    'linearised: while norm.is_normal()
        && let Some(jacobian) = jacobian(u.as_slice())
    {
        let gradient = jacobian.tr_mul(&errors);
        let normal = jacobian.tr_mul(&jacobian);
        let columns = normal.diagonal().map(f64::sqrt);
        let cosine = gradient
            .iter()
            .zip(&columns)
            .map(|(gradient, column)| (gradient / norm / column).abs())
            .fold(0.0, f64::max);
        if cosine <= COSINE {
            break;
        }
        let region = region.get_or_insert_with(|| TrustRegion::new(&columns, &u));
        region.scale = region.scale.sup(&columns);
        loop {
            let Some(step) = region.step(&normal, &gradient, damping) else {
                break 'linearised;
            };
            damping = step.damping;
            let bend = (step.p.dot(&(&normal * &step.p)).sqrt() / norm).powi(2);
            let damped = (damping.sqrt() * step.length / norm).powi(2);
            let predicted = bend + 2.0 * damped;
            let slope = -(bend + damped);
            if evaluations == 1 {
                region.size = region.size.min(step.length);
            }
            let next = &u - &step.p;
            let next_errors = residuals(next.as_slice());
            let next_norm = next_errors.norm();
            evaluations += 1;
            let actual = if 0.1 * next_norm < norm {
                1.0 - (next_norm / norm).powi(2)
            } else {
                -1.0
            };
            let ratio = if predicted == 0.0 {
                0.0
            } else {
                actual / predicted
            };
            if ratio <= 0.25 {
                let mut shrunk = if actual >= 0.0 {
                    0.5
                } else {
                    0.5 * slope / (slope + 0.5 * actual)
                };
                if 0.1 * next_norm >= norm || shrunk < 0.1 {
                    shrunk = 0.1;
                }
                region.size = shrunk * region.size.min(10.0 * step.length);
                damping /= shrunk;
            } else if damping == 0.0 || ratio >= 0.75 {
                region.size = 2.0 * step.length;
                damping *= 0.5;
            }
            let better = ratio >= 1e-4;
            if better {
                u = next;
                errors = next_errors;
                norm = next_norm;
            }
            let settled = actual.abs() <= REDUCTION && predicted <= REDUCTION && ratio <= 2.0;
            if settled || region.size <= STEP * region.length(&u) || evaluations >= limit {
                break 'linearised;
            }
            if better {
                break;
            }
        }
    }
    u.as_slice().to_vec()
}

/// Steps are at most `size` long, each parameter over its scale.
struct TrustRegion {
    scale: DVector<f64>,
    size: f64,
}

struct Step {
    p: DVector<f64>,
    /// Levenberg's and Marquardt's parameter.
    damping: f64,
    length: f64,
}

impl TrustRegion {
    fn new(columns: &DVector<f64>, u: &DVector<f64>) -> Self {
        let scale = columns.map(|column| if column == 0.0 { 1.0 } else { column });
        let size = scale.component_mul(u).norm();
        Self {
            scale,
            size: if size == 0.0 { 1.0 } else { size },
        }
    }

    fn length(&self, p: &DVector<f64>) -> f64 {
        self.scale.component_mul(p).norm()
    }

    /// The step that minimises the linearised residuals within the region. None if it is not
    /// finite.
    fn step(&self, normal: &DMatrix<f64>, gradient: &DVector<f64>, damping: f64) -> Option<Step> {
        let solve = |damping: f64| {
            let mut damped = normal.clone();
            for (index, scale) in self.scale.iter().enumerate() {
                damped[(index, index)] += damping * scale * scale;
            }
            let factors = damped.cholesky()?;
            let p = factors.solve(gradient);
            let length = self.length(&p);
            length.is_finite().then_some((factors, p, length))
        };
        let (factors, p, length) = solve(0.0)?;
        let mut excess = length - self.size;
        if excess <= TOLERANCE * self.size {
            return Some(Step {
                p,
                damping: 0.0,
                length,
            });
        }
        let mut lower = self.correction(&factors, &p, length);
        let mut upper = gradient.component_div(&self.scale).norm() / self.size;
        let mut damping = damping.max(lower).min(upper);
        if damping == 0.0 {
            damping = gradient.component_div(&self.scale).norm() / length;
        }
        let mut attempt = 1;
        loop {
            if damping == 0.0 {
                damping = f64::MIN_POSITIVE.max(0.001 * upper);
            }
            let (factors, p, length) = solve(damping)?;
            let last = excess;
            excess = length - self.size;
            let found = excess.abs() <= TOLERANCE * self.size
                || (lower == 0.0 && excess <= last && last < 0.0);
            if found || attempt == ATTEMPTS {
                return Some(Step { p, damping, length });
            }
            if excess > 0.0 {
                lower = lower.max(damping);
            } else {
                upper = upper.min(damping);
            }
            damping = lower.max(damping + self.correction(&factors, &p, length));
            attempt += 1;
        }
    }

    /// Newton's correction of the damping, for a step of the region's size.
    fn correction(
        &self,
        factors: &Cholesky<f64, nalgebra::Dyn>,
        p: &DVector<f64>,
        length: f64,
    ) -> f64 {
        let direction = p.component_mul(&self.scale).component_mul(&self.scale) / length;
        let curvature = direction.dot(&factors.solve(&direction));
        (length - self.size) / self.size / curvature
    }
}

#[cfg(test)]
mod tests {
    use core::cell::Cell;

    use super::*;

    /// Rosenbrock's valley, from its usual start, with a weak prior.
    #[test]
    fn the_minimum_of_a_curved_valley_is_found() {
        let residuals = |u: &[f64]| {
            DVector::from_vec(vec![
                10.0 * (u[1] - u[0] * u[0]),
                1.0 - u[0],
                1e-9 * u[0],
                1e-9 * u[1],
            ])
        };
        let jacobian = |u: &[f64]| {
            Some(DMatrix::from_row_slice(
                4,
                2,
                &[-20.0 * u[0], 10.0, -1.0, 0.0, 1e-9, 0.0, 0.0, 1e-9],
            ))
        };
        let evaluations = Cell::new(0);
        let counted = |u: &[f64]| {
            evaluations.set(evaluations.get() + 1);
            residuals(u)
        };
        let minimum = minimise(&[-1.2, 1.0], counted, jacobian, 100);
        let evaluated = evaluations.replace(0);
        assert!(evaluated < 40, "{evaluated}");
        for u in &minimum {
            assert!((u - 1.0).abs() < 1e-6, "{minimum:?}");
        }
        let impatient = minimise(&[-1.2, 1.0], counted, jacobian, 3);
        assert_eq!(evaluations.get(), 3);
        let better = residuals(&impatient).norm() < residuals(&[-1.2, 1.0]).norm();
        assert!(better, "{impatient:?}");
    }

    #[test]
    fn a_linear_problem_takes_the_step_of_the_normal_equations() {
        let matrix = DMatrix::from_row_slice(3, 2, &[1.0, 2.0, -1.0, 0.5, 3.0, 1.0]);
        let target = DVector::from_vec(vec![1.0, -0.5, 2.0]);
        let minimum = minimise(
            &[0.0, 0.0],
            |u| &matrix * DVector::from_column_slice(u) - &target,
            |_| Some(matrix.clone()),
            100,
        );
        let normal = matrix.tr_mul(&matrix);
        let exact = normal.lu().solve(&matrix.tr_mul(&target)).unwrap();
        let error = (DVector::from_column_slice(&minimum) - exact).norm();
        assert!(error < 1e-9, "{error}");
    }

    #[test]
    fn without_a_jacobian_the_start_is_kept() {
        let evaluations = Cell::new(0);
        let residuals = |u: &[f64]| {
            evaluations.set(evaluations.get() + 1);
            DVector::from_column_slice(u)
        };
        let minimum = minimise(&[2.0], residuals, |_| None, 100);
        assert_eq!((minimum, evaluations.get()), (vec![2.0], 1));
    }
}
