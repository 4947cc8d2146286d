//! Values of keys: their ranges, their conversion by unit, and why one is refused.

use core::{fmt, ops::RangeInclusive};

/// A value that has a range.
pub trait Numbers {
    /// Its numbers, each of which must be in the range.
    fn numbers(&self) -> Vec<f64>;
}

macro_rules! numbers {
    ($($type:ty),+) => {
        $(impl Numbers for $type {
            fn numbers(&self) -> Vec<f64> {
                vec![*self as f64]
            }
        })+
    };
}

numbers!(f64, u8, u16, u32, u64, i16);

impl<T: Numbers, const N: usize> Numbers for [T; N] {
    fn numbers(&self) -> Vec<f64> {
        self.iter().flat_map(T::numbers).collect()
    }
}

impl<T: Numbers> Numbers for Vec<T> {
    fn numbers(&self) -> Vec<f64> {
        self.iter().flat_map(T::numbers).collect()
    }
}

impl<T: Numbers> Numbers for Option<T> {
    fn numbers(&self) -> Vec<f64> {
        self.as_ref().map_or_else(Vec::new, T::numbers)
    }
}

/// What a number may be.
pub trait Rule {
    /// Whether it may be this; never what is not a number.
    fn allows(&self, number: f64) -> bool;

    /// What it must be, as the end of a sentence.
    fn fix(&self) -> String;
}

impl<T: Copy + Into<f64>> Rule for RangeInclusive<T> {
    fn allows(&self, number: f64) -> bool {
        ((*self.start()).into()..=(*self.end()).into()).contains(&number)
    }

    fn fix(&self) -> String {
        let (lowest, highest): (f64, f64) = ((*self.start()).into(), (*self.end()).into());
        format!("it must lie between {lowest} and {highest}")
    }
}

/// See [`up_to`].
#[derive(Clone, Copy, Debug)]
pub struct UpTo(f64);

/// Above zero, up to `highest`.
pub const fn up_to(highest: f64) -> UpTo {
    UpTo(highest)
}

impl Rule for UpTo {
    fn allows(&self, number: f64) -> bool {
        number > 0.0 && number <= self.0
    }

    fn fix(&self) -> String {
        format!("it must be above 0 and at most {}", self.0)
    }
}

/// See [`in_words`].
#[derive(Clone, Copy, Debug)]
pub struct Worded {
    words: &'static str,
    allows: fn(f64) -> bool,
}

/// A finite number for which `allows` holds; `words` follow "it must be".
pub const fn in_words(words: &'static str, allows: fn(f64) -> bool) -> Worded {
    Worded { words, allows }
}

impl Rule for Worded {
    fn allows(&self, number: f64) -> bool {
        number.is_finite() && (self.allows)(number)
    }

    fn fix(&self) -> String {
        format!("it must be {}", self.words)
    }
}

/// Refuses a value with a number that the rule does not allow.
///
/// # Errors
///
/// The first such number.
pub fn check(
    key: &'static str,
    value: &(impl Numbers + ?Sized),
    rule: &impl Rule,
) -> Result<(), ValueError> {
    match value.numbers().into_iter().find(|&x| !rule.allows(x)) {
        Some(number) => Err(ValueError::new(key, number, rule.fix())),
        None => Ok(()),
    }
}

/// From a key's value to that of the field that it is for, and back. The key's name states
/// the unit: a field in seconds or nanoseconds takes `_ms` and `_us`.
pub trait Convert<T> {
    /// The field's value.
    fn to_inner(self, key: &str) -> T;

    /// The key's value.
    fn from_inner(inner: T, key: &str) -> Self;
}

impl<T> Convert<T> for T {
    fn to_inner(self, _: &str) -> T {
        self
    }

    fn from_inner(inner: T, _: &str) -> Self {
        inner
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
pub fn seconds(milliseconds: u32) -> f64 {
    f64::from(milliseconds) / 1_000.0
}

/// A value that is outside its range, or contradicts another.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key} is {value}: {fix}")]
pub struct ValueError {
    /// The key.
    pub key: &'static str,
    /// Its value.
    pub value: String,
    /// What it may be.
    pub fix: String,
}

impl ValueError {
    /// The error of this key and value.
    pub fn new(key: &'static str, value: impl fmt::Display, fix: impl Into<String>) -> Self {
        Self {
            key,
            value: value.to_string(),
            fix: fix.into(),
        }
    }
}
