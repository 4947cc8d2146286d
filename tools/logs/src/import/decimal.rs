//! Times in decimal digits.
//!
//! A unix time in seconds with seven decimals has more digits than a float: the difference of
//! two would be wrong by 0.2 us.

/// Digits below this power of ten of the result are left out.
const LEAST_POWER: i32 = -9;

/// The decimal number `text` times 10 to the power of `exponent`, rounded to the nearest
/// integer; `None` if it is not a decimal number or does not fit.
pub(super) fn scaled(text: &str, exponent: i32) -> Option<i64> {
    let (text, written) = match text.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok()?),
        None => (text, 0),
    };
    let (is_negative, text) = match text.strip_prefix('-') {
        Some(text) => (true, text),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    if whole.is_empty() && fraction.is_empty() {
        return None;
    }
    let mut digits: i128 = 0;
    let mut shift = exponent.checked_add(written)?;
    for (place, byte) in whole.bytes().chain(fraction.bytes()).enumerate() {
        let digit = byte.is_ascii_digit().then(|| i128::from(byte - b'0'))?;
        if place >= whole.len() {
            if shift <= LEAST_POWER {
                continue;
            }
            shift -= 1;
        }
        digits = digits.checked_mul(10)?.checked_add(digit)?;
    }
    let power = |shift: i32| 10_i128.checked_pow(shift.unsigned_abs());
    let value = match shift {
        0.. if digits == 0 => 0,
        0.. => digits.checked_mul(power(shift)?)?,
        _ => match power(shift) {
            Some(divisor) => (digits + divisor / 2) / divisor,
            None => 0,
        },
    };
    i64::try_from(if is_negative { -value } else { value }).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_digit_of_a_unix_time_counts() {
        for (text, exponent, number) in [
            ("1706804704.2263625", 9, 1_706_804_704_226_362_500),
            ("1706804704226.3625", 6, 1_706_804_704_226_362_500),
            ("1706804704226362501", 0, 1_706_804_704_226_362_501),
            ("1.7068047042263625e9", 9, 1_706_804_704_226_362_500),
            ("0.0000000014", 9, 1),
            ("0.0000000015", 9, 2),
            ("-0.5", 9, -500_000_000),
            ("+.5", 9, 500_000_000),
            ("5.", 0, 5),
            ("0e30", 9, 0),
            ("1e-50", 9, 0),
        ] {
            assert_eq!(scaled(text, exponent), Some(number), "{text}");
        }
    }

    #[test]
    fn many_decimals_are_rounded() {
        let third = format!("0.{}", "3".repeat(60));
        assert_eq!(scaled(&third, 9), Some(333_333_333));
    }

    #[test]
    fn what_is_no_decimal_number_or_too_large_is_refused() {
        for text in [
            "",
            ".",
            "-",
            "nan",
            "inf",
            "1.2.3",
            "1 2",
            "0x10",
            "1e",
            "1e99",
            "12:00",
            "--1",
            "9300000000000",
            "1e2147483647",
        ] {
            assert_eq!(scaled(text, 9), None, "{text}");
        }
    }
}
