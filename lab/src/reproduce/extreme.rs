//! The least and the largest of measured values. Without values, or with one that is not a
//! number, the result is not a number: it counts as not measured.

/// The largest, or not a number.
pub(super) fn largest(values: impl Iterator<Item = f64>) -> f64 {
    extreme(values, f64::max)
}

/// The least, or not a number.
pub(super) fn least(values: impl Iterator<Item = f64>) -> f64 {
    extreme(values, f64::min)
}

fn extreme(values: impl Iterator<Item = f64>, of: fn(f64, f64) -> f64) -> f64 {
    values
        .reduce(|extreme, value| {
            if extreme.is_nan() || value.is_nan() {
                f64::NAN
            } else {
                of(extreme, value)
            }
        })
        .unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_and_what_is_not_a_number_have_no_extremes() {
        assert_eq!(largest([1.0, -3.0, 2.0].into_iter()), 2.0);
        assert_eq!(least([1.0, -3.0, 2.0].into_iter()), -3.0);
        for values in [
            &[][..],
            &[f64::NAN, 1.0],
            &[1.0, f64::NAN],
            &[1.0, f64::NAN, 2.0],
        ] {
            assert!(largest(values.iter().copied()).is_nan(), "{values:?}");
            assert!(least(values.iter().copied()).is_nan(), "{values:?}");
        }
    }
}
