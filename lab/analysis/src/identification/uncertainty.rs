//! The covariance of the estimates.

use nalgebra::{DMatrix, DVector};

use super::{predictor::Prediction, problem::Problem};

/// The spread of the estimates in the coordinates of the optimiser.
#[derive(Clone, Debug)]
pub(super) struct Spread {
    /// Covariance for white prediction errors: the inverse of the information matrix.
    pub(super) white: DMatrix<f64>,
    /// Covariance for errors that are correlated within [`BLOCK`].
    pub(super) robust: DMatrix<f64>,
    /// Standard deviation of each parameter by the wider of the two.
    pub(super) deviations: Vec<f64>,
}

/// Standard deviations at u = 0 from the information matrix alone, without the prior.
pub(super) fn bounds(prediction: &Prediction<'_>) -> Option<Vec<f64>> {
    let count = prediction.settings.parameters.len();
    let jacobian = prediction.jacobian(&vec![0.0; count])?;
    let rows = jacobian.rows(0, jacobian.nrows() - count);
    let covariance = rows.tr_mul(&rows).cholesky()?.inverse();
    Some(covariance.diagonal().iter().map(|x| x.sqrt()).collect())
}

/// Prediction errors farther apart than this count as independent, in s.
pub(super) const BLOCK: f64 = 0.5;

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
