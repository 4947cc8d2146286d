//! Samples in the order of their times: interpolated, or held.

/// Nanoseconds in a second.
const SECOND_NS: u64 = 1_000_000_000;

/// A sample of a sensor or of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample<const N: usize> {
    /// When it was measured, or in force from, on the clock of the record.
    pub(super) time_ns: u64,
    /// Its values.
    pub(super) values: [f64; N],
}

/// How samples are interpolated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Interpolation {
    /// Samples per second.
    pub(super) rate_hz: u32,
    /// Between samples that are farther apart there is nothing.
    pub(super) longest_gap_ns: u64,
}

/// Samples with the rule for the time between them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Series<const N: usize> {
    pub(super) samples: Vec<Sample<N>>,
    interpolation: Option<Interpolation>,
}

impl<const N: usize> Series<N> {
    /// Samples in the order of their times. Without an interpolation a value is held until the
    /// next one.
    pub(super) const fn new(samples: Vec<Sample<N>>, interpolation: Option<Interpolation>) -> Self {
        Self {
            samples,
            interpolation,
        }
    }

    /// The times of the samples of the log.
    pub(super) fn times_ns(&self) -> impl Iterator<Item = u64> {
        self.samples.iter().map(|sample| sample.time_ns)
    }

    /// The values at a time: of the last of several samples of that time. `None` before the first
    /// one, and where an interpolation has nothing.
    pub(super) fn at(&self, time_ns: u64) -> Option<[f64; N]> {
        let after = self.samples.partition_point(|one| one.time_ns <= time_ns);
        let before = self.samples.get(after.checked_sub(1)?)?;
        match self.interpolation {
            Some(interpolation) if before.time_ns != time_ns => {
                between(before, self.samples.get(after)?, time_ns, interpolation)
            }
            _ => Some(before.values),
        }
    }

    /// All samples, or those at the rate of the interpolation: at whole multiples of its period,
    /// of which the first row of the log is one.
    pub(super) fn resampled(&self) -> Vec<Sample<N>> {
        let Some(interpolation) = self.interpolation else {
            return self.samples.clone();
        };
        let rate = u64::from(interpolation.rate_hz.max(1));
        let first = self.samples.first().map_or(0, |sample| sample.time_ns);
        let last = self.samples.last().map_or(0, |sample| sample.time_ns);
        let number =
            |time_ns: u64| (u128::from(time_ns) * u128::from(rate)) / u128::from(SECOND_NS);
        let mut resampled = Vec::new();
        for point in number(first)..=number(last) {
            let time_ns = (point * u128::from(SECOND_NS) / u128::from(rate)) as u64;
            let values = self.at(time_ns);
            resampled.extend(values.map(|values| Sample { time_ns, values }));
        }
        resampled
    }
}

/// Linear between two samples, if they are not too far apart.
fn between<const N: usize>(
    before: &Sample<N>,
    after: &Sample<N>,
    time_ns: u64,
    interpolation: Interpolation,
) -> Option<[f64; N]> {
    let gap_ns = after.time_ns - before.time_ns;
    if gap_ns > interpolation.longest_gap_ns {
        return None;
    }
    let share = (time_ns - before.time_ns) as f64 / gap_ns as f64;
    let mut values = before.values;
    for (value, after) in values.iter_mut().zip(after.values) {
        *value += share * (after - *value);
    }
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERPOLATION: Interpolation = Interpolation {
        rate_hz: 100,
        longest_gap_ns: 30_000_000,
    };

    fn series(samples: &[(u64, f64)], interpolation: Option<Interpolation>) -> Series<1> {
        let samples = samples.iter().map(|(time_ms, value)| Sample {
            time_ns: time_ms * 1_000_000,
            values: [*value],
        });
        Series::new(samples.collect(), interpolation)
    }

    fn resampled(samples: &[(u64, f64)]) -> Vec<(u64, f64)> {
        let points = series(samples, Some(INTERPOLATION)).resampled();
        let rounded = |value: f64| (value * 1e9).round() / 1e9;
        let point = |one: &Sample<1>| (one.time_ns / 1_000_000, rounded(one.values[0]));
        points.iter().map(point).collect()
    }

    #[test]
    fn between_samples_values_are_linear_on_whole_periods() {
        assert_eq!(
            resampled(&[(1_005, 1.0), (1_025, 3.0), (1_035, 0.0)]),
            [(1_010, 1.5), (1_020, 2.5), (1_030, 1.5)]
        );
    }

    #[test]
    fn the_values_of_samples_on_the_grid_are_kept() {
        assert_eq!(
            resampled(&[(1_000, 1.0), (1_010, 3.0), (1_020, 0.0)]),
            [(1_000, 1.0), (1_010, 3.0), (1_020, 0.0)]
        );
    }

    #[test]
    fn nothing_is_made_up_in_a_long_gap_before_the_first_or_after_the_last_sample() {
        assert_eq!(
            resampled(&[(1_005, 1.0), (1_015, 2.0), (1_046, 9.0), (1_056, 8.0)]),
            [(1_010, 1.5), (1_050, 8.6)]
        );
        let gap = series(&[(1_000, 1.0), (1_031, 2.0)], Some(INTERPOLATION));
        assert_eq!(gap.at(1_000_000_000), Some([1.0]));
        for time_ms in [999, 1_001, 1_030, 1_032] {
            assert_eq!(gap.at(time_ms * 1_000_000), None, "{time_ms}");
        }
    }

    #[test]
    fn of_two_samples_of_one_time_the_last_one_counts() {
        let samples = [(1_000, 1.0), (1_010, 2.0), (1_010, 4.0), (1_020, 6.0)];
        assert_eq!(
            resampled(&samples),
            [(1_000, 1.0), (1_010, 4.0), (1_020, 6.0)]
        );
        let series = series(&samples, Some(INTERPOLATION));
        assert_eq!(series.at(1_010_000_000), Some([4.0]));
        assert_eq!(series.at(1_015_000_000), Some([5.0]));
    }

    #[test]
    fn without_interpolation_samples_are_kept_and_held() {
        let held = series(&[(1_003, 1.0), (2_000, 2.0)], None);
        assert_eq!(held.resampled().len(), 2);
        assert_eq!(held.at(1_002_999_999), None);
        assert_eq!(held.at(1_999_999_999), Some([1.0]));
        assert_eq!(held.at(9_000_000_000), Some([2.0]));
    }

    #[test]
    fn no_samples_are_no_values() {
        for interpolation in [None, Some(INTERPOLATION)] {
            let none = series(&[], interpolation);
            assert_eq!(none.resampled(), []);
            assert_eq!(none.at(1_000_000_000), None);
        }
    }
}
