//! What many numbers boil down to.

/// Numbers in order of size; what is none is left out.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Distribution(Vec<f64>);

impl Distribution {
    pub(super) fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values
            .into_iter()
            .filter(|value| value.is_finite())
            .collect();
        values.sort_by(f64::total_cmp);
        Self(values)
    }

    pub(super) fn sorted(&self) -> &[f64] {
        &self.0
    }

    pub(super) fn least(&self) -> Option<f64> {
        self.0.first().copied()
    }

    pub(super) fn most(&self) -> Option<f64> {
        self.0.last().copied()
    }

    /// The least of the values that `part` (0 to 1) of all do not exceed.
    pub(super) fn quantile(&self, part: f64) -> Option<f64> {
        let rank = (part * self.0.len() as f64).ceil() as usize;
        self.0.get(rank.max(1) - 1).copied()
    }

    pub(super) fn root_mean_square(&self) -> Option<f64> {
        let squares: f64 = self.0.iter().map(|value| value * value).sum();
        (!self.0.is_empty()).then(|| (squares / self.0.len() as f64).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_occur() {
        let values = Distribution::of((1..=100).map(f64::from).chain([f64::NAN]));
        assert_eq!(values.quantile(0.5), Some(50.0));
        assert_eq!(values.quantile(0.99), Some(99.0));
        assert_eq!(values.quantile(1.0), values.most());
        assert_eq!(values.quantile(0.0), values.least());
        assert_eq!(Distribution::of([]).quantile(0.5), None);
    }

    #[test]
    fn the_root_mean_square_is_that() {
        assert_eq!(
            Distribution::of([3.0, -4.0]).root_mean_square(),
            Some(12.5_f64.sqrt())
        );
        assert_eq!(Distribution::of([f64::NAN]).root_mean_square(), None);
    }
}
