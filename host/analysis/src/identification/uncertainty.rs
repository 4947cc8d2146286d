//! How well a fit knows what it says.

use nalgebra_levenberg_marquardt::{DMatrix, DVector};

use super::predictor::Question;

/// The spread of the estimates, all in u.
#[derive(Clone, Debug)]
pub(super) struct Spread {
    /// Covariance if the prediction errors are white: the inverse of the information.
    pub(super) white: DMatrix<f64>,
    /// Covariance whatever their colour within [`BLOCK`].
    pub(super) robust: DMatrix<f64>,
    /// The wider of the two, for each parameter.
    pub(super) deviations: Vec<f64>,
}

/// Standard deviations at u = 0 from the information alone, whatever the errors are.
pub(super) fn bounds(question: &Question<'_>) -> Option<Vec<f64>> {
    let count = question.active.len();
    let jacobian = question.jacobian(&vec![0.0; count])?;
    let rows = jacobian.rows(0, jacobian.nrows() - count);
    let covariance = rows.tr_mul(&rows).cholesky()?.inverse();
    Some(covariance.diagonal().iter().map(|x| x.sqrt()).collect())
}

/// Prediction errors farther apart than this are taken as independent, in s.
const BLOCK: f64 = 0.5;

/// The spread around `u`. None where the model ends, or where nothing tells a
/// combination of the parameters.
pub(super) fn spread(question: &Question<'_>, u: &[f64]) -> Option<Spread> {
    let jacobian = question.jacobian(u)?;
    let residuals = question.residuals(u)?;
    let information = jacobian.tr_mul(&jacobian);
    let white = information.cholesky()?.inverse();
    let count = u.len();
    let rows = residuals.len() - count;
    // Sums of the scores over blocks of time.
    let mut blocks: std::collections::BTreeMap<i64, DVector<f64>> =
        std::collections::BTreeMap::new();
    for (row, time) in question.times().into_iter().enumerate().take(rows) {
        let residual = residuals[row];
        if residual != 0.0 {
            let score = blocks
                .entry((time / BLOCK).floor() as i64)
                .or_insert_with(|| DVector::zeros(count));
            for column in 0..count {
                score[column] += jacobian[(row, column)] * residual;
            }
        }
    }
    // What is known beforehand counts once.
    let mut meat = DMatrix::identity(count, count);
    for score in blocks.values() {
        meat += score * score.transpose();
    }
    // Few blocks look less varied than they are.
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
