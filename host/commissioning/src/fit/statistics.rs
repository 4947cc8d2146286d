//! Means and their intervals, and least squares with a few parameters.

use core::borrow::Borrow;

use nalgebra::{SMatrix, SVector};
use singletrack_control::student_quantile;

use crate::Interval;

/// The values as a list.
fn listed(values: impl IntoIterator<Item: Borrow<f64>>) -> Vec<f64> {
    values.into_iter().map(|value| *value.borrow()).collect()
}

/// The mean; none of no values.
pub(crate) fn mean(values: impl IntoIterator<Item: Borrow<f64>>) -> Option<f64> {
    let values = listed(values);
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The standard deviation of the values around their mean; none of fewer than two.
pub(crate) fn standard_deviation(values: impl IntoIterator<Item: Borrow<f64>>) -> Option<f64> {
    let values = listed(values);
    let mean = mean(&values)?;
    let freedom = values.len().checked_sub(1).filter(|freedom| *freedom > 0)?;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    Some((squares / freedom as f64).sqrt())
}

/// The median; none of no values.
pub(crate) fn median(values: impl IntoIterator<Item: Borrow<f64>>) -> Option<f64> {
    let mut sorted = listed(values);
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    let upper = *sorted.get(middle)?;
    match sorted.len() % 2 {
        0 => Some(f64::midpoint(*sorted.get(middle - 1)?, upper)),
        _ => Some(upper),
    }
}

/// The mean of values with independent errors, such as those of separate passes, with its 95 %
/// interval. `systematic` bounds the error that all of them share. None of fewer than two
/// values: one pass says nothing of its error.
pub(crate) fn mean_interval(
    values: impl IntoIterator<Item: Borrow<f64>>,
    systematic: f64,
) -> Option<Interval> {
    let values = listed(values);
    let deviation = standard_deviation(&values)?;
    let statistical = student_quantile(values.len() - 1) * deviation / (values.len() as f64).sqrt();
    Some(Interval::around(mean(&values)?, statistical).widened(systematic))
}

/// The means of `count` blocks of equal length; values that are left over are dropped. Long
/// blocks have independent errors where successive values have not.
pub(crate) fn block_means(values: &[f64], count: usize) -> Vec<f64> {
    let Some(length) = values.len().checked_div(count).filter(|length| *length > 0) else {
        return Vec::new();
    };
    let blocks = values.chunks_exact(length).take(count);
    blocks.filter_map(mean).collect()
}

/// The intervals of estimates from several passes or blocks, by leaving out one after the
/// other (the jackknife). It needs no model of the errors within a pass. `systematic` bounds the
/// errors that all passes share. None if there are fewer than two passes, or if the estimate
/// fails without one of them.
pub(crate) fn jackknife<T, const N: usize>(
    passes: &[T],
    systematic: [f64; N],
    estimate: impl Fn(&[&T]) -> Option<[f64; N]>,
) -> Option<[Interval; N]> {
    let freedom = passes.len().checked_sub(1).filter(|freedom| *freedom > 0)?;
    let all: Vec<&T> = passes.iter().collect();
    let whole = estimate(&all)?;
    let without: Vec<[f64; N]> = (0..all.len())
        .map(|left_out| {
            let mut chosen = all.clone();
            chosen.remove(left_out);
            estimate(&chosen)
        })
        .collect::<Option<_>>()?;
    let quantile = student_quantile(freedom);
    Some(std::array::from_fn(|index| {
        let values: Vec<f64> = without.iter().map(|one| one[index]).collect();
        let error = quantile * left_out_deviation(&values);
        Interval::around(whole[index], error).widened(systematic[index])
    }))
}

/// The standard deviation of an estimate by what it becomes if each part is left out once.
pub(crate) fn left_out_deviation(left_out: &[f64]) -> f64 {
    let count = left_out.len() as f64;
    let mean = left_out.iter().sum::<f64>() / count;
    let squares = left_out.iter().map(|value| (value - mean).powi(2));
    ((count - 1.0) / count * squares.sum::<f64>()).sqrt()
}

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

/// The steps of the iteration.
const STEPS: usize = 60;

/// The parameters near `start` that make the residuals least. `scale` is a step by which each
/// parameter may be changed for its derivative, and `bounds` is where it must stay. None if the
/// residuals do not determine the parameters.
pub(crate) fn gauss_newton<const N: usize>(
    start: [f64; N],
    scale: [f64; N],
    bounds: [[f64; 2]; N],
    residuals: impl Fn(&[f64; N]) -> Vec<f64>,
) -> Option<[f64; N]> {
    let within = |mut parameters: [f64; N]| {
        for (value, [low, high]) in parameters.iter_mut().zip(bounds) {
            *value = value.clamp(low, high);
        }
        parameters
    };
    let squares = |residuals: &[f64]| residuals.iter().map(|r| r * r).sum::<f64>();
    let mut best = within(start);
    let mut residual = residuals(&best);
    let mut least = squares(&residual);
    for _ in 0..STEPS {
        let shifted: Vec<Vec<f64>> = (0..N)
            .map(|index| {
                let mut near = best;
                near[index] += scale[index];
                residuals(&near)
            })
            .collect();
        let rows = residual.iter().enumerate().map(|(row, value)| {
            let slopes: [f64; N] = std::array::from_fn(|i| value - shifted[i][row]);
            (slopes, *value)
        });
        let step = least_squares(rows)?.parameters;
        let mut share = 1.0;
        let mut has_moved = false;
        // Shorter steps, if a whole one leads too far.
        for _ in 0..6 {
            let next = within(std::array::from_fn(|i| {
                best[i] + share * step[i] * scale[i]
            }));
            let found = residuals(&next);
            let sum = squares(&found);
            if sum < least {
                has_moved = (least - sum) > 1e-9 * least;
                (best, residual, least) = (next, found, sum);
                break;
            }
            share *= 0.4;
        }
        if !has_moved {
            break;
        }
    }
    best.iter().all(|value| value.is_finite()).then_some(best)
}

#[cfg(test)]
mod tests {
    use singletrack_control::statistics::Random;

    use super::*;

    /// How many of `trials` intervals hold the truth, in percent.
    fn coverage(trials: u64, mut interval: impl FnMut(u64) -> (Interval, f64)) -> f64 {
        let held = (0..trials)
            .filter(|trial| {
                let (interval, truth) = interval(*trial);
                interval.contains(truth)
            })
            .count();
        100.0 * held as f64 / trials as f64
    }

    #[test]
    fn mean_deviation_and_median_are_those_of_the_book() {
        let values = [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0];
        assert_eq!(mean(values), Some(5.0));
        let deviation = standard_deviation(values).unwrap();
        assert!((deviation - (32.0_f64 / 7.0).sqrt()).abs() < 1e-12);
        assert_eq!(median(values), Some(4.5));
        assert_eq!(median([3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!((mean([0.0; 0]), median([0.0; 0])), (None, None));
        assert_eq!(standard_deviation([1.0]), None);
    }

    #[test]
    fn nine_of_ten_intervals_of_few_passes_hold_the_mean_and_not_all_do() {
        for count in [2, 3, 5, 20] {
            let held = coverage(2_000, |trial| {
                let mut noise = Random::new(trial);
                let values: Vec<f64> = (0..count).map(|_| 7.0 + 0.3 * noise.normal(1.0)).collect();
                (mean_interval(&values, 0.0).unwrap(), 7.0)
            });
            assert!((93.0..97.0).contains(&held), "{count} passes: {held} %");
        }
    }

    #[test]
    fn one_pass_gives_no_interval() {
        assert_eq!(mean_interval([1.0], 0.1), None);
        assert!(
            jackknife(&[1.0], [0.1], |all| {
                Some([mean(all.iter().map(|v| **v))?])
            })
            .is_none()
        );
    }

    #[test]
    fn means_of_long_blocks_are_honest_about_correlated_noise() {
        let readings = |trial| {
            let mut noise = Random::new(trial);
            let mut wander = 0.0;
            (0..6_000)
                .map(|_| {
                    // Correlated over 50 readings.
                    wander = 0.98 * wander + 0.02 * noise.normal(1.0);
                    wander
                })
                .collect::<Vec<f64>>()
        };
        let single = coverage(500, |trial| {
            (mean_interval(readings(trial), 0.0).unwrap(), 0.0)
        });
        let blocks = coverage(500, |trial| {
            let means = block_means(&readings(trial), 10);
            (mean_interval(&means, 0.0).unwrap(), 0.0)
        });
        assert!(single < 40.0, "single readings: {single} %");
        assert!((91.0..98.0).contains(&blocks), "blocks: {blocks} %");
    }

    #[test]
    fn blocks_drop_what_is_left_over() {
        assert_eq!(block_means(&[1.0, 3.0, 5.0, 7.0, 100.0], 2), [2.0, 6.0]);
        assert_eq!(block_means(&[1.0], 2), [0.0; 0]);
    }

    #[test]
    fn the_jackknife_of_a_mean_is_the_interval_of_the_mean() {
        let values = [1.0, 2.0, 4.0, 8.0];
        let [found] = jackknife(&values, [0.0], |chosen| {
            let chosen: Vec<_> = chosen.iter().map(|value| **value).collect();
            Some([mean(&chosen)?])
        })
        .unwrap();
        let expected = mean_interval(values, 0.0).unwrap();
        assert!((found.low - expected.low).abs() < 1e-12);
        assert!((found.high - expected.high).abs() < 1e-12);
    }

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

    #[test]
    fn an_exponential_is_found_from_far_and_stays_within_its_bounds() {
        let mut noise = Random::new(5);
        let data: Vec<(f64, f64)> = (0..400)
            .map(|index| {
                let time = 0.01 * f64::from(index);
                (
                    time,
                    2.0 * (1.0 - (-time / 0.7).exp()) + 0.01 * noise.normal(1.0),
                )
            })
            .collect();
        let fit = |bounds| {
            gauss_newton([0.5, 0.1], [1e-3, 1e-3], bounds, |[level, lag]| {
                data.iter()
                    .map(|(time, value)| value - level * (1.0 - (-time / lag).exp()))
                    .collect()
            })
            .unwrap()
        };
        let [level, lag] = fit([[0.0, 10.0], [0.01, 5.0]]);
        assert!(
            (level - 2.0).abs() < 0.01 && (lag - 0.7).abs() < 0.01,
            "{level} {lag}"
        );
        let [_, lag] = fit([[0.0, 10.0], [0.01, 0.5]]);
        assert!((lag - 0.5).abs() < 1e-9);
    }

    #[test]
    fn what_has_no_effect_is_not_determined() {
        let found = gauss_newton([1.0, 1.0], [0.1, 0.1], [[0.0, 9.0]; 2], |[level, _]| {
            vec![level - 2.0, level - 3.0, level - 1.0]
        });
        assert_eq!(found, None);
    }
}
