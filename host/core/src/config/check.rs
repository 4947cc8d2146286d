//! Values in their ranges.

use core::{fmt::Display, ops::RangeInclusive};

use super::ConfigError;

/// Refuses what is outside `range`, and what is no number.
pub(super) fn within<T: PartialOrd + Display>(
    key: &'static str,
    value: T,
    range: RangeInclusive<T>,
) -> Result<(), ConfigError> {
    if range.contains(&value) {
        return Ok(());
    }
    let (lowest, highest) = range.into_inner();
    Err(ConfigError::value(
        key,
        value,
        format!("it must lie between {lowest} and {highest}"),
    ))
}

/// Refuses what is not above zero, or above `highest`, and what is no number.
pub(super) fn positive(key: &'static str, value: f64, highest: f64) -> Result<(), ConfigError> {
    if value > 0.0 && value <= highest {
        return Ok(());
    }
    Err(ConfigError::value(
        key,
        value,
        format!("it must be above 0 and at most {highest}"),
    ))
}

/// Seconds of milliseconds.
pub(super) fn seconds(milliseconds: u32) -> f64 {
    f64::from(milliseconds) / 1_000.0
}
