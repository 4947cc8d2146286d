//! From values to places on the page, and which values to write there.

use super::superscript;

/// How values are spread along an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    #[default]
    Linear,
    /// Logarithmic: decades are as long as each other. Values above zero only.
    Log,
}

/// An axis with its ends, on the page.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ruler {
    scale: Scale,
    /// The values at its ends.
    pub(super) range: [f64; 2],
    /// Where the ends are, in mm.
    place: [f64; 2],
}

impl Ruler {
    pub(super) const fn new(scale: Scale, range: [f64; 2], place: [f64; 2]) -> Self {
        Self {
            scale,
            range,
            place,
        }
    }

    /// Where `value` is, in mm.
    pub(super) fn at(&self, value: f64) -> f64 {
        let [low, high] = self.range.map(|end| self.even(end));
        let part = (self.even(value) - low) / (high - low);
        self.place[0] + part * (self.place[1] - self.place[0])
    }

    /// Whether `value` is on the axis.
    pub(super) fn holds(&self, value: f64) -> bool {
        let [low, high] = self.range;
        (low..=high).contains(&value)
    }

    fn even(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => value,
            Scale::Log => value.log10(),
        }
    }

    /// The values to write, about `count` of them, with their text.
    pub(super) fn ticks(&self, count: usize) -> Vec<(f64, String)> {
        let [low, high] = self.range;
        match self.scale {
            Scale::Linear => {
                let wide = step((high - low) / count.max(1) as f64);
                // Two numbers are too few to read between.
                let is_sparse = (high / wide).floor() - (low / wide).ceil() < 2.0 && count > 1;
                let step = if is_sparse { step(0.4 * wide) } else { wide };
                let decimals = decimals(step);
                let slack = 1e-9 * (high - low);
                let first = ((low - slack) / step).ceil() as i64;
                let last = ((high + slack) / step).floor() as i64;
                let values = (first..=last).map(|index| index as f64 * step);
                let text = |value| minus(format!("{value:.decimals$}"));
                values.map(|value| (value, text(value))).collect()
            }
            Scale::Log => {
                let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
                // Between few decades there is room for more.
                let factors: &[f64] = if high.log10() - low.log10() < 2.5 {
                    &[1.0, 2.0, 5.0]
                } else {
                    &[1.0]
                };
                let slack = 1e-9 * (high - low);
                (first..=last)
                    .flat_map(|power| factors.iter().map(move |factor| (power, *factor)))
                    .map(|(power, factor)| (factor * 10_f64.powi(power), power, factor))
                    .filter(|(value, ..)| (low - slack..=high + slack).contains(value))
                    .map(|(value, power, factor)| (value, power_text(value, power, factor)))
                    .collect()
            }
        }
    }
}

/// A value on an axis of decades.
fn power_text(value: f64, power: i32, factor: f64) -> String {
    // Where zeros are hard to count.
    if !(4..=7).contains(&power) {
        let decimals = usize::try_from(-power).unwrap_or(0);
        return format!("{value:.decimals$}");
    }
    let zeros = superscript(&power.to_string());
    if factor > 1.0 {
        format!("{factor}\u{b7}10{zeros}")
    } else {
        format!("10{zeros}")
    }
}

/// The next of 1, 2, 5, 10, ... times a power of ten that is not less.
fn step(at_least: f64) -> f64 {
    if !(at_least.is_finite() && at_least > 0.0) {
        return 1.0;
    }
    let power = 10_f64.powf(at_least.log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|factor| factor * power)
        .find(|step| *step >= at_least * (1.0 - 1e-9))
        .unwrap_or(10.0 * power)
}

/// Digits behind the point up to the first that is not zero: as many as a multiple of `step` needs.
pub fn decimals(step: f64) -> usize {
    let digits = -(step.abs().log10() + 1e-9).floor();
    if digits.is_finite() && digits > 0.0 {
        digits as usize
    } else {
        0
    }
}

/// A number to this many decimals, without needless digits.
pub(crate) fn trimmed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0" } else { text }.to_owned()
}

/// A real minus sign, and no minus zero.
pub fn minus(text: String) -> String {
    match text.strip_prefix('-') {
        Some(digits) if digits.bytes().all(|byte| matches!(byte, b'0' | b'.')) => digits.to_owned(),
        Some(digits) => format!("\u{2212}{digits}"),
        None => text,
    }
}

/// The ends of an axis for data between `low` and `high`: somewhat wider, never empty.
pub(super) fn roomy([low, high]: [f64; 2]) -> [f64; 2] {
    let least = 1e-6_f64.max(1e-3 * low.abs().max(high.abs()));
    let spread = high - low;
    if spread < least {
        let middle = 0.5 * (low + high);
        let half = if middle == 0.0 {
            1.0
        } else {
            0.1 * middle.abs()
        };
        return [middle - half, middle + half];
    }
    [low - 0.06 * spread, high + 0.06 * spread]
}

/// Widens the shorter of two ranges so that a unit is as long on both axes, in an
/// area of `width` times `height`.
pub(super) fn equalise(x: [f64; 2], y: [f64; 2], width: f64, height: f64) -> ([f64; 2], [f64; 2]) {
    let unit = ((x[1] - x[0]) / width).max((y[1] - y[0]) / height);
    let widen = |[low, high]: [f64; 2], length: f64| {
        let (middle, half) = (0.5 * (low + high), 0.5 * unit * length);
        [middle - half, middle + half]
    };
    (widen(x, width), widen(y, height))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(range: [f64; 2], count: usize) -> Vec<String> {
        let ruler = Ruler::new(Scale::Linear, range, [0.0, 1.0]);
        ruler
            .ticks(count)
            .into_iter()
            .map(|(_, text)| text)
            .collect()
    }

    #[test]
    fn ticks_are_round_numbers_within_the_axis() {
        assert_eq!(texts([0.0, 40.0], 5), ["0", "10", "20", "30", "40"]);
        assert_eq!(
            texts([-1.06, 1.06], 5),
            ["\u{2212}1.0", "\u{2212}0.5", "0.0", "0.5", "1.0"]
        );
        assert_eq!(texts([0.0, 0.0041], 4), ["0.000", "0.002", "0.004"]);
        assert_eq!(texts([0.0, 1234.0], 3), ["0", "500", "1000"]);
        assert_eq!(texts([0.0, 39.9], 3), ["0", "10", "20", "30"]);
        let few = ["\u{2212}0.4", "\u{2212}0.2", "0.0", "0.2", "0.4", "0.6"];
        assert_eq!(texts([-0.4, 0.75], 3), few);
    }

    #[test]
    fn decades_are_as_long_as_each_other() {
        let ruler = Ruler::new(Scale::Log, [1.0, 1000.0], [10.0, 40.0]);
        assert!((ruler.at(10.0) - 20.0).abs() < 1e-12);
        let texts: Vec<_> = ruler.ticks(9).into_iter().map(|(_, text)| text).collect();
        assert_eq!(texts, ["1", "10", "100", "1000"]);
    }

    #[test]
    fn few_decades_are_divided_and_need_not_be_whole() {
        let ruler = Ruler::new(Scale::Log, [0.05, 3.0], [0.0, 1.0]);
        let texts: Vec<_> = ruler.ticks(9).into_iter().map(|(_, text)| text).collect();
        assert_eq!(texts, ["0.05", "0.1", "0.2", "0.5", "1", "2"]);
        let ruler = Ruler::new(Scale::Log, [20.0, 30_000.0], [0.0, 1.0]);
        let texts: Vec<_> = ruler.ticks(9).into_iter().map(|(_, text)| text).collect();
        assert_eq!(texts, ["100", "1000", "10\u{2074}"]);
    }

    #[test]
    fn an_axis_is_never_empty() {
        for [low, high] in [[0.0, 0.0], [3.0, 3.0], [-0.2, -0.2], [1.0, 1.0 + 1e-12]] {
            let [from, to] = roomy([low, high]);
            assert!(from < low && high < to, "{from} {to}");
        }
    }

    #[test]
    fn equal_axes_have_equal_units_and_lose_nothing() {
        let (x, y) = equalise([-1.0, 1.0], [0.0, 0.5], 60.0, 60.0);
        assert_eq!(x, [-1.0, 1.0]);
        assert_eq!(y, [-0.75, 1.25]);
    }
}
