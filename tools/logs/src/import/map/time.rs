//! The time of the rows of a log.

use serde::Deserialize;

use super::{check_positive, invalid};

/// The time of a row: of a CSV file in a column, of a bag in each message.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeSection {
    /// The column of a CSV file.
    pub column: Option<String>,
    /// Its unit.
    pub unit: Option<TimeUnit>,
    /// Whether it counts from the start of 1970, UTC. Otherwise its zero has no meaning.
    pub unix: Option<bool>,
    /// The longest time between two rows that is not taken for an error of the log, in s.
    #[serde(default = "longest_gap_s")]
    pub longest_gap_s: f64,
}

const fn longest_gap_s() -> f64 {
    10.0
}

impl Default for TimeSection {
    fn default() -> Self {
        Self {
            column: None,
            unit: None,
            unix: None,
            longest_gap_s: longest_gap_s(),
        }
    }
}

/// The unit of a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum TimeUnit {
    /// Seconds.
    #[default]
    #[serde(rename = "s")]
    Seconds,
    /// Milliseconds.
    #[serde(rename = "ms")]
    Milliseconds,
    /// Microseconds.
    #[serde(rename = "us")]
    Microseconds,
    /// Nanoseconds.
    #[serde(rename = "ns")]
    Nanoseconds,
}

impl TimeUnit {
    /// The power of ten by which a number in this unit is multiplied to be in ns.
    pub(in crate::import) const fn exponent(self) -> i32 {
        match self {
            Self::Seconds => 9,
            Self::Milliseconds => 6,
            Self::Microseconds => 3,
            Self::Nanoseconds => 0,
        }
    }
}

impl TimeSection {
    pub(super) fn check(&self) -> Result<(), String> {
        check_positive("time.longest_gap_s", self.longest_gap_s)
    }

    /// Fails if the section is not one for a CSV file.
    pub(super) fn check_rows(&self) -> Result<(), String> {
        let missing = |key, fix| Err(invalid(key, "missing", fix));
        if self.column.is_none() {
            return missing("time.column", "name the column of the time of a row");
        }
        if self.unit.is_none() {
            let fix = "give the unit of that column: \"s\", \"ms\", \"us\" or \"ns\"";
            return missing("time.unit", fix);
        }
        if self.unix.is_none() {
            let fix = "set it to true if the time counts from 1970, to false if not";
            return missing("time.unix", fix);
        }
        Ok(())
    }

    /// Fails if the section is not one for a bag.
    pub(super) fn check_bag(&self) -> Result<(), String> {
        let fix = "remove it: the messages of a bag have times of their own, see `stamp`";
        match &self.column {
            Some(column) => Err(invalid("time.column", format!("{column:?}"), fix)),
            None if self.unit.is_some() => Err(invalid("time.unit", "given", fix)),
            None if self.unix.is_some() => Err(invalid("time.unix", "given", fix)),
            None => Ok(()),
        }
    }
}
