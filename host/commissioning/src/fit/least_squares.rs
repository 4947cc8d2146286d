//! Linear least squares with a few parameters.

use nalgebra::{SMatrix, SVector};

/// A solution of [`least_squares`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LeastSquares<const N: usize> {
    /// The parameters.
    pub(crate) parameters: [f64; N],
    /// Standard errors of the parameters if the errors of the equations are independent. Those
    /// of successive readings are not: take the interval from several passes instead.
    pub(crate) standard_errors: [f64; N],
    /// Root mean square of the residuals.
    pub(crate) residual: f64,
    /// The number of equations.
    pub(crate) count: usize,
}

/// Solves `row · parameters = value` for many rows. None if the rows do not determine the
/// parameters.
pub(crate) fn least_squares<const N: usize>(
    equations: impl Iterator<Item = ([f64; N], f64)> + Clone,
) -> Option<LeastSquares<N>> {
    let mut normal = SMatrix::<f64, N, N>::zeros();
    let mut right = SVector::<f64, N>::zeros();
    let mut count = 0_usize;
    for (row, value) in equations.clone() {
        let row = SVector::from(row);
        normal += row * row.transpose();
        right += row * value;
        count += 1;
    }
    let inverse = inverted(&normal)?;
    let parameters = inverse * right;
    let squares: f64 = equations
        .map(|(row, value)| (value - parameters.dot(&SVector::from(row))).powi(2))
        .sum();
    let freedom = count.saturating_sub(N).max(1) as f64;
    Some(LeastSquares {
        parameters: parameters.into(),
        standard_errors: std::array::from_fn(|i| (inverse[(i, i)] * squares / freedom).sqrt()),
        residual: (squares / count.max(1) as f64).sqrt(),
        count,
    })
}

/// The inverse of a symmetric matrix that is positive definite; none if it is not, to the
/// precision of the numbers.
pub(super) fn inverted<const N: usize>(matrix: &SMatrix<f64, N, N>) -> Option<SMatrix<f64, N, N>> {
    /// A pivot below this part of its diagonal element is rounding.
    const SINGULAR: f64 = 1e-12;
    let factors = matrix.cholesky()?;
    let pivots = factors.l_dirty().diagonal().map(|root| root * root);
    let is_regular = (0..N).all(|i| pivots[i] > SINGULAR * matrix[(i, i)]);
    is_regular.then(|| factors.inverse())
}

#[cfg(test)]
mod tests {
    use super::*;
    use singletrack_statistics::Random;

    #[test]
    fn a_line_is_found_with_the_errors_of_the_book() {
        let x = [1.0, 2.0, 3.0, 4.0];
        let y = [6.0, 5.0, 7.0, 10.0];
        let rows = x.iter().zip(y).map(|(x, y)| ([1.0, *x], y));
        let fit = least_squares(rows).unwrap();
        assert!((fit.parameters[0] - 3.5).abs() < 1e-12);
        assert!((fit.parameters[1] - 1.4).abs() < 1e-12);
        // Residuals 1.1, -1.3, -0.7, 0.9; s² = 4.2 / 2, divided by the spread of x, 5.
        assert!((fit.standard_errors[1] - (2.1_f64 / 5.0).sqrt()).abs() < 1e-12);
        assert!((fit.residual - (4.2_f64 / 4.0).sqrt()).abs() < 1e-12);
        assert_eq!(fit.count, 4);
    }

    #[test]
    fn four_parameters_are_found_through_noise() {
        let mut noise = Random::new(3);
        let truth = [0.3, -1.2, 0.05, 4.0];
        let equations: Vec<_> = (0..4_000)
            .map(|_| {
                let row: [f64; 4] = std::array::from_fn(|_| noise.normal(1.0));
                let value: f64 = row.iter().zip(truth).map(|(a, b)| a * b).sum();
                (row, value + 0.1 * noise.normal(1.0))
            })
            .collect();
        let fit = least_squares(equations.iter().copied()).unwrap();
        for (index, truth) in truth.into_iter().enumerate() {
            let error = (fit.parameters[index] - truth).abs();
            assert!(error < 4.0 * fit.standard_errors[index], "{index}: {error}");
            assert!((fit.standard_errors[index] - 0.1 / 4_000_f64.sqrt()).abs() < 2e-4);
        }
    }

    #[test]
    fn what_the_rows_do_not_determine_is_refused() {
        let same = |x: f64| ([1.0, x, 2.0 * x], 1.0);
        assert!(least_squares([same(1.0), same(2.0), same(3.0)].into_iter()).is_none());
        assert!(least_squares::<1>(std::iter::empty()).is_none());
        assert!(least_squares([([f64::NAN], 1.0)].into_iter()).is_none());
    }
}
