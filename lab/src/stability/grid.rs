//! A range of values on the command line.

use std::str::FromStr;

/// The largest number of points.
const MOST_POINTS: f64 = 100_000.0;

/// Evenly spaced values: `A:B:STEP` with both ends, or a single value.
///
/// Values have no more decimals than what was written, so that they print as a person
/// would write them.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid(Vec<f64>);

impl Grid {
    /// `count` values from `from` to `to`, both included.
    #[must_use]
    pub fn spanning([from, to]: [f64; 2], count: usize) -> Self {
        let last = count.saturating_sub(1).max(1) as f64;
        Self(
            (0..count)
                .map(|index| from + (to - from) * index as f64 / last)
                .collect(),
        )
    }

    /// The values, ascending; never empty if written on the command line.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.0
    }

    /// Each value with all of `other`.
    pub(super) fn with<'a>(&'a self, other: &'a Self) -> impl Iterator<Item = (f64, f64)> + 'a {
        let all = |one: &'a f64| other.0.iter().map(|other| (*one, *other));
        self.0.iter().flat_map(all)
    }
}

impl FromStr for Grid {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            let number = text.trim().parse::<f64>().ok();
            number.filter(|number| number.is_finite()).ok_or_else(|| {
                format!("{text:?} is not a number; write A:B:STEP, such as 0.1:8:0.1")
            })
        };
        let parts: Vec<&str> = text.split(':').collect();
        let (from, to, step) = match parts[..] {
            [value] => return Ok(Self(vec![number(value)?])),
            [from, to, step] => (number(from)?, number(to)?, number(step)?),
            _ => return Err("write A:B:STEP, such as 0.1:8:0.1, or a single value".to_owned()),
        };
        if step <= 0.0 {
            return Err(format!("the step is {step}: it must be above zero"));
        }
        if to < from {
            return Err(format!(
                "it ends at {to}, before it begins at {from}; write the smaller value first"
            ));
        }
        // A last value that misses B by roundings alone is meant.
        let steps = ((to - from) / step + 1e-9).floor();
        if steps >= MOST_POINTS {
            return Err(format!(
                "it has {} values, more than {MOST_POINTS}; take a larger step",
                steps + 1.0
            ));
        }
        let decimals = parts.iter().map(|part| decimals(part)).max().unwrap_or(0);
        Ok(Self(
            (0..=steps as u32)
                .map(|index| rounded(from + f64::from(index) * step, decimals))
                .collect(),
        ))
    }
}

/// How many decimals a number is written with.
fn decimals(text: &str) -> usize {
    let text = text.trim().to_ascii_lowercase();
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let written = mantissa
        .split_once('.')
        .map_or(0, |(_, decimals)| decimals.len());
    let shift: i64 = exponent.parse().unwrap_or(0);
    let decimals = i64::try_from(written)
        .unwrap_or(i64::MAX)
        .saturating_sub(shift);
    usize::try_from(decimals.max(0)).unwrap_or(0)
}

/// The value rounded to a number of decimals.
fn rounded(value: f64, decimals: usize) -> f64 {
    // Beyond that, rounding to decimals changes nothing.
    if decimals > 15 {
        return value;
    }
    let rounded = format!("{value:.decimals$}").parse().unwrap_or(value);
    // No minus zero.
    if rounded == 0.0 { 0.0 } else { rounded }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(text: &str) -> Vec<f64> {
        text.parse::<Grid>().unwrap().values().to_vec()
    }

    #[test]
    fn both_ends_belong_to_it_and_values_are_those_one_would_write() {
        assert_eq!(values("0.1:0.5:0.1"), [0.1, 0.2, 0.3, 0.4, 0.5]);
        assert_eq!(values("-0.1:0.1:0.05"), [-0.1, -0.05, 0.0, 0.05, 0.1]);
        assert_eq!(values("0:1:0.4"), [0.0, 0.4, 0.8]);
        assert_eq!(values("1e-1:3e-1:1e-1"), [0.1, 0.2, 0.3]);
        assert_eq!(values("2"), [2.0]);
        assert_eq!(values("0.1:8:0.05").len(), 159);
        assert_eq!(values("0.1:8:0.1").len(), 80);
        assert_eq!(values("-0.6:0.6:0.01").len(), 121);
    }

    #[test]
    fn what_is_no_range_is_refused_with_its_fix() {
        for (text, words) in [
            ("1:2", "A:B:STEP"),
            ("1:2:3:4", "A:B:STEP"),
            ("a:2:1", "\"a\""),
            ("1:2:nan", "\"nan\""),
            ("1:2:0", "above zero"),
            ("2:1:0.1", "smaller value first"),
            ("0:1:1e-9", "larger step"),
            ("", "\"\""),
        ] {
            let error = text.parse::<Grid>().unwrap_err();
            assert!(error.contains(words), "{text}: {error}");
        }
    }

    #[test]
    fn a_span_has_its_count_of_values_and_both_ends() {
        assert_eq!(
            Grid::spanning([-1.0, 1.0], 5).values(),
            [-1.0, -0.5, 0.0, 0.5, 1.0]
        );
        assert_eq!(Grid::spanning([2.0, 3.0], 1).values(), [2.0]);
    }
}
