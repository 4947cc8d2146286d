//! A student, and the numbers that belong to the name.

use super::error::LabError;

/// A student. Names that differ in spaces or capitals alone are the same student's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Student {
    name: String,
    key: String,
}

impl Student {
    /// The student of this name.
    ///
    /// # Errors
    ///
    /// A name without a letter or a digit.
    pub fn new(name: &str) -> Result<Self, LabError> {
        let words: Vec<&str> = name.split_whitespace().collect();
        if !name.chars().any(char::is_alphanumeric) {
            return Err(LabError::NoName(name.to_owned()));
        }
        let name = words.join(" ");
        Ok(Self {
            key: name.to_lowercase(),
            name,
        })
    }

    /// The name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The student's number of this name in a lab: `first` plus a multiple of `step`, one of
    /// `count` such numbers.
    pub(super) fn number(&self, lab: u8, name: &str, grid: Grid) -> f64 {
        let text = format!("{lab} {name} {}", self.key);
        let step = hash(text.as_bytes()) % u64::from(grid.count.max(1));
        let value = grid.first + step as f64 * grid.step;
        // As it is printed: sums of steps have digits of their own.
        (value * 1e6).round() / 1e6
    }
}

/// Evenly spaced numbers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    pub(super) first: f64,
    pub(super) step: f64,
    pub(super) count: u32,
}

/// `count` numbers from `first` on.
pub(super) const fn grid(first: f64, step: f64, count: u32) -> Grid {
    Grid { first, step, count }
}

/// FNV-1a of 64 bits, mixed so that the low bits depend on all letters.
fn hash(bytes: &[u8]) -> u64 {
    let hash = bytes.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    });
    (hash ^ (hash >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 17
}
