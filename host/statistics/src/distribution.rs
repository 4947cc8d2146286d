//! The exact distribution of values that fit into memory.

/// Values in ascending order; values that are not finite are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Distribution(Vec<f64>);

impl Distribution {
    /// The distribution of `values`, in the unit of the values.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let finite = values.into_iter().filter(|value| value.is_finite());
        let mut values: Vec<f64> = finite.collect();
        values.sort_unstable_by(f64::total_cmp);
        Self(values)
    }

    /// The values in ascending order.
    #[must_use]
    pub fn sorted(&self) -> &[f64] {
        &self.0
    }

    /// The number of values.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// The smallest value.
    #[must_use]
    pub fn min(&self) -> Option<f64> {
        self.0.first().copied()
    }

    /// The largest value.
    #[must_use]
    pub fn max(&self) -> Option<f64> {
        self.0.last().copied()
    }

    /// The smallest value that `part` (0 to 1) of all values do not exceed. It is one of
    /// the values; values between two are not interpolated.
    #[must_use]
    pub fn quantile(&self, part: f64) -> Option<f64> {
        let rank = (part * self.0.len() as f64).ceil() as usize;
        self.0.get(rank.max(1) - 1).copied()
    }

    /// How many values are smaller than `bound`.
    #[must_use]
    pub fn count_below(&self, bound: f64) -> usize {
        self.0.partition_point(|value| *value < bound)
    }

    /// How many values are at most `bound`.
    #[must_use]
    pub fn count_up_to(&self, bound: f64) -> usize {
        self.0.partition_point(|value| *value <= bound)
    }

    /// The root mean square of the values.
    #[must_use]
    pub fn root_mean_square(&self) -> Option<f64> {
        crate::RootMeanSquare::of(self.0.iter().copied()).value()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_occur() {
        let values = Distribution::of((1..=100).map(f64::from).chain([f64::NAN]));
        assert_eq!(values.count(), 100);
        assert_eq!(values.quantile(0.5), Some(50.0));
        assert_eq!(values.quantile(0.99), Some(99.0));
        assert_eq!(values.quantile(1.0), values.max());
        assert_eq!(values.quantile(0.0), values.min());
        assert_eq!(Distribution::of([]).quantile(0.5), None);
    }

    #[test]
    fn ranks_of_per_mille_are_exact() {
        for count in 1..=2_000_u32 {
            let values = Distribution::of((1..=count).map(f64::from));
            for per_mille in [500, 900, 990, 999] {
                let rank = (count * per_mille).div_ceil(1_000);
                assert_eq!(
                    values.quantile(f64::from(per_mille) / 1_000.0),
                    Some(f64::from(rank)),
                    "{per_mille} of {count}"
                );
            }
        }
    }

    #[test]
    fn a_value_at_a_bound_is_up_to_it_and_not_below_it() {
        let values = Distribution::of([2.0, 1.0, 2.0, 3.0]);
        assert_eq!(values.count_below(2.0), 1);
        assert_eq!(values.count_up_to(2.0), 3);
        assert_eq!(values.sorted(), [1.0, 2.0, 2.0, 3.0]);
    }

    #[test]
    fn only_finite_values_have_a_root_mean_square() {
        assert_eq!(
            Distribution::of([3.0, -4.0]).root_mean_square(),
            Some(12.5_f64.sqrt())
        );
        assert_eq!(Distribution::of([f64::NAN]).root_mean_square(), None);
    }
}
