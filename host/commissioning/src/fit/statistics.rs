//! Means and their intervals.

use core::borrow::Borrow;

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
    let count = passes.len() as f64;
    Some(std::array::from_fn(|index| {
        let values: Vec<f64> = without.iter().map(|one| one[index]).collect();
        let centre = mean(&values).unwrap_or(whole[index]);
        let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
        let error = (squares * (count - 1.0) / count).sqrt();
        Interval::around(whole[index], quantile * error).widened(systematic[index])
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use singletrack_statistics::Random;

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
}
