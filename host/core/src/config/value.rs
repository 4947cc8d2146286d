//! Values of keys: their types in words, their ranges, and their conversion by unit.

use core::{
    net::{IpAddr, Ipv4Addr},
    ops::RangeInclusive,
};
use std::path::PathBuf;

use super::ConfigError;

/// What the type of a key says.
pub(super) trait Typed {
    /// The type in words; for a choice its texts, each after a comma.
    const TYPE: &'static str;

    /// The numbers of a value, each of which must lie in the key's range.
    fn numbers(&self) -> Vec<f64> {
        Vec::new()
    }
}

macro_rules! typed {
    ($($words:literal $type:ty $(=> $numbers:expr)?;)+) => {
        $(impl Typed for $type {
            const TYPE: &'static str = $words;

            $(fn numbers(&self) -> Vec<f64> {
                $numbers(self)
            })?
        })+
    };
}

typed! {
    "true or false" bool;
    "text" String;
    "text" PathBuf;
    "IP address" Ipv4Addr;
    "IP address" IpAddr;
    "whole number" u8 => |&number| vec![f64::from(number)];
    "whole number" u16 => |&number| vec![f64::from(number)];
    "whole number" i16 => |&number| vec![f64::from(number)];
    "whole number" u32 => |&number| vec![f64::from(number)];
    "number" f64 => |&number| vec![number];
    "two numbers" [f64; 2] => |pair: &[f64; 2]| pair.to_vec();
    "list of two numbers each" Vec<[f64; 2]> => |pairs: &Vec<[f64; 2]>| pairs.concat();
}

impl<T: Typed> Typed for Option<T> {
    const TYPE: &'static str = T::TYPE;

    fn numbers(&self) -> Vec<f64> {
        self.as_ref().map_or_else(Vec::new, T::numbers)
    }
}

/// The values that a key may have: to `highest`, from `lowest` or above it.
pub(super) struct Range {
    lowest: f64,
    is_above: bool,
    highest: f64,
}

/// Above zero, up to `highest`.
pub(super) const fn up_to(highest: f64) -> Range {
    Range {
        lowest: 0.0,
        is_above: true,
        highest,
    }
}

impl<T: Into<f64>> From<RangeInclusive<T>> for Range {
    fn from(range: RangeInclusive<T>) -> Self {
        let (lowest, highest) = range.into_inner();
        Self {
            lowest: lowest.into(),
            is_above: false,
            highest: highest.into(),
        }
    }
}

/// Refuses a value with a number outside its range, and what is not a number.
pub(super) fn check(
    key: &'static str,
    value: &impl Typed,
    range: impl Into<Range>,
) -> Result<(), ConfigError> {
    let Range {
        lowest,
        is_above,
        highest,
    } = range.into();
    for number in value.numbers() {
        let is_in = number <= highest && (number > lowest || !is_above && number == lowest);
        if !is_in {
            let rule = if is_above {
                format!("it must be above {lowest} and at most {highest}")
            } else {
                format!("it must lie between {lowest} and {highest}")
            };
            return Err(ConfigError::value(key, number, rule));
        }
    }
    Ok(())
}

/// From a key's value to that of the field that it is for, and back. The key's name states
/// the unit: a field in seconds or nanoseconds takes `_ms` and `_us`.
pub(super) trait Convert<T> {
    /// The field's value.
    fn to_inner(self, key: &str) -> T;

    /// The key's value.
    fn from_inner(inner: T, key: &str) -> Self;
}

macro_rules! same {
    ($($type:ty),+) => {
        $(impl Convert<$type> for $type {
            fn to_inner(self, _: &str) -> $type {
                self
            }

            fn from_inner(inner: $type, _: &str) -> Self {
                inner
            }
        })+
    };
}

same!(bool, u16, i16, u32);

impl Convert<f64> for f64 {
    fn to_inner(self, key: &str) -> f64 {
        match key.ends_with("_ms") {
            true => self / 1_000.0,
            false => self,
        }
    }

    fn from_inner(inner: f64, key: &str) -> Self {
        match key.ends_with("_ms") {
            true => inner * 1_000.0,
            false => inner,
        }
    }
}

/// Whole milliseconds, of seconds.
impl Convert<f64> for u32 {
    fn to_inner(self, _: &str) -> f64 {
        seconds(self)
    }

    fn from_inner(inner: f64, _: &str) -> Self {
        // Times in a configuration are a few seconds at most.
        (inner * 1_000.0).round() as u32
    }
}

/// Whole milliseconds or microseconds, of nanoseconds.
impl Convert<u64> for u32 {
    fn to_inner(self, key: &str) -> u64 {
        u64::from(self) * nanoseconds(key)
    }

    fn from_inner(inner: u64, key: &str) -> Self {
        // Times in a configuration are a few seconds at most.
        (inner / nanoseconds(key)) as u32
    }
}

/// Milliseconds, of nanoseconds with a sign.
impl Convert<i64> for f64 {
    fn to_inner(self, _: &str) -> i64 {
        (self * 1e6).round() as i64
    }

    fn from_inner(inner: i64, _: &str) -> Self {
        inner as Self / 1e6
    }
}

/// Nanoseconds in the unit of a key.
fn nanoseconds(key: &str) -> u64 {
    match key.ends_with("_us") {
        true => 1_000,
        false => 1_000_000,
    }
}

/// Seconds of milliseconds.
pub(super) fn seconds(milliseconds: u32) -> f64 {
    f64::from(milliseconds) / 1_000.0
}
