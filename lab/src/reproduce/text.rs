//! Numbers as a reader wants them.

use singletrack_figures::figure::{minus, superscript};
use singletrack_scenario::simulate::trim_zeros;

/// A number in a sentence, with four significant digits; a plant that could not be driven has none.
pub(super) fn told(value: Option<f64>, unit: &str) -> String {
    let value = value.filter(|value| value.is_finite());
    value.map_or_else(
        || "(not driven)".to_owned(),
        |value| format!("{} {unit}", with_digits(value, 4)),
    )
}

/// A number with about five significant digits, without trailing zeros; very small and very large
/// ones as a power of ten.
pub(super) fn number(value: f64) -> String {
    with_digits(value, 5)
}

/// A number with the given number of significant digits, without trailing zeros; very small and
/// very large ones as a power of ten.
pub(super) fn with_digits(value: f64, digits: i32) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    if !value.is_finite() {
        return if value.is_nan() {
            "not a number"
        } else {
            "∞"
        }
        .to_owned();
    }
    let size = value.abs();
    if (1e-3..1e6).contains(&size) {
        let decimals = usize::try_from(digits - 1 - size.log10().floor() as i32).unwrap_or(0);
        return minus(trim_zeros(&format!("{value:.decimals$}")).to_owned());
    }
    let short = usize::try_from(digits.min(3) - 1).unwrap_or(0);
    let text = format!("{value:.short$e}");
    let Some((mantissa, exponent)) = text.split_once('e') else {
        return text;
    };
    let (mantissa, power) = (trim_zeros(mantissa), superscript(exponent));
    minus(format!("{mantissa}×10{power}"))
}

/// A length given in m, in mm.
pub(super) fn mm(metres: f64) -> String {
    format!("{} mm", with_digits(metres * 1000.0, 3))
}

/// A length given in m, in m.
pub(super) fn metres(value: f64) -> String {
    format!("{} m", with_digits(value, 4))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_keep_their_size() {
        for (value, text) in [
            (0.0, "0"),
            (0.894_427_19, "0.89443"),
            (-0.142_728, "−0.14273"),
            (1.0, "1"),
            (120.0, "120"),
            (9680.0, "9680"),
            (7.1e-11, "7.1×10⁻¹¹"),
            (-2.5e7, "−2.5×10⁷"),
            (0.001_36, "0.00136"),
            (f64::INFINITY, "∞"),
        ] {
            assert_eq!(number(value), text);
        }
        assert_eq!(mm(0.000_135_977), "0.136 mm");
        assert_eq!(metres(0.246_4), "0.2464 m");
    }
}
