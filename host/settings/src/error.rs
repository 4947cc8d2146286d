//! Why a value is refused.

use core::fmt;

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
