//! Why a set-point has no effect, and the count of those.

use core::{fmt, sync::atomic::AtomicU64};
use std::{collections::BTreeMap, sync::atomic::Ordering};

use serde::Serialize;
use singletrack_control::SetpointError;
use singletrack_pilot::SetpointRefusal;

/// Why a set-point has no effect, as a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejection {
    /// The line is no set-point.
    Invalid,
    /// A value is infinite or not a number.
    NotFinite,
    /// A value is beyond that of any car, or a trajectory is not one.
    OutOfRange,
    /// It was decided later than now, or its trajectory begins too late.
    Future,
    /// It is older than the time-out, or its trajectory is over.
    Old,
    /// Its number is not above the last one of this connection.
    Sequence,
    /// Another connection gives the set-points.
    OtherSource,
    /// The reference in force is not external.
    NotExternal,
}

impl Rejection {
    const ALL: [Self; 8] = [
        Self::Invalid,
        Self::NotFinite,
        Self::OutOfRange,
        Self::Future,
        Self::Old,
        Self::Sequence,
        Self::OtherSource,
        Self::NotExternal,
    ];

    /// The word in answers and figures.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Invalid => "invalid",
            Self::NotFinite => "not-finite",
            Self::OutOfRange => "out-of-range",
            Self::Future => "future",
            Self::Old => "old",
            Self::Sequence => "sequence",
            Self::OtherSource => "other-source",
            Self::NotExternal => "not-external",
        }
    }
}

impl From<SetpointError> for Rejection {
    fn from(error: SetpointError) -> Self {
        match error {
            SetpointError::NotFinite => Self::NotFinite,
            SetpointError::OutOfRange(_) | SetpointError::Incomplete => Self::OutOfRange,
            SetpointError::Future => Self::Future,
            SetpointError::Old | SetpointError::Superseded => Self::Old,
        }
    }
}

/// Why a set-point has no effect: the text of the answer and the word.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::socket) struct Rejected {
    pub(in crate::socket) why: Rejection,
    pub(in crate::socket) text: String,
}

impl Rejected {
    pub(super) fn new(why: Rejection, text: impl fmt::Display) -> Self {
        Self {
            why,
            text: text.to_string(),
        }
    }
}

/// Counts of set-points since the daemon started.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SetpointFigures {
    /// Passed on to the control thread.
    pub accepted: u64,
    /// Rejected, by the word of the answer; without the words that never occurred.
    pub rejected: BTreeMap<&'static str, u64>,
    /// Accepted, and refused by the pilot at its tick; by the pilot's word.
    pub refused: BTreeMap<&'static str, u64>,
}

/// Counts set-points.
#[derive(Debug, Default)]
pub(crate) struct SetpointCounters {
    pub(super) accepted: AtomicU64,
    rejected: [AtomicU64; Rejection::ALL.len()],
    refused: [AtomicU64; SetpointRefusal::ALL.len()],
}

impl SetpointCounters {
    /// The counts so far.
    pub(crate) fn figures(&self) -> SetpointFigures {
        SetpointFigures {
            accepted: self.accepted.load(Ordering::Relaxed),
            rejected: counted(Rejection::ALL.map(Rejection::name), &self.rejected),
            refused: counted(
                SetpointRefusal::ALL.map(SetpointRefusal::name),
                &self.refused,
            ),
        }
    }

    pub(super) fn reject(&self, why: Rejection) {
        count(&Rejection::ALL, &self.rejected, &why);
    }

    /// The pilot refused one that was accepted.
    pub(crate) fn refuse(&self, why: SetpointRefusal) {
        count(&SetpointRefusal::ALL, &self.refused, &why);
    }
}

fn count<T: PartialEq>(all: &[T], counters: &[AtomicU64], which: &T) {
    for (_, counter) in all
        .iter()
        .zip(counters)
        .filter(|(other, _)| *other == which)
    {
        counter.fetch_add(1, Ordering::Relaxed);
    }
}

fn counted<const N: usize>(
    names: [&'static str; N],
    counters: &[AtomicU64; N],
) -> BTreeMap<&'static str, u64> {
    let counts = counters
        .iter()
        .map(|counter| counter.load(Ordering::Relaxed));
    names
        .into_iter()
        .zip(counts)
        .filter(|(_, count)| *count > 0)
        .collect()
}

/// Why a line that does not parse is rejected as a set-point; `None` if it is none.
///
/// JSON has no word for what is not finite. Programs write `NaN` or `Infinity`, which is no
/// JSON, `null`, or a number that is too large.
pub(in crate::socket) fn unreadable(line: &[u8], text: &str) -> Option<Rejection> {
    let contains = |part: &[u8]| line.windows(part.len()).any(|window| window == part);
    contains(b"\"setpoint\"").then(|| {
        let is_number = text.contains("invalid type: null, expected f64")
            || text.contains("number out of range");
        let is_word = [&b"NaN"[..], b"nan", b"Infinity", b"inf"];
        if is_number || is_word.into_iter().any(contains) {
            Rejection::NotFinite
        } else {
            Rejection::Invalid
        }
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn every_rejection_and_refusal_is_counted_by_its_word() {
        let counters = SetpointCounters::default();
        for (count, why) in (1..).zip(Rejection::ALL) {
            for _ in 0..count {
                counters.reject(why);
            }
        }
        for (count, why) in (1..).zip(SetpointRefusal::ALL) {
            for _ in 0..count {
                counters.refuse(why);
            }
        }
        assert_eq!(
            serde_json::to_value(counters.figures()).unwrap(),
            json!({
                "accepted": 0,
                "rejected": {
                    "invalid": 1, "not-finite": 2, "out-of-range": 3, "future": 4, "old": 5,
                    "sequence": 6, "other-source": 7, "not-external": 8,
                },
                "refused": {
                    "not-finite": 1, "out-of-range": 2, "future": 3, "old": 4, "superseded": 5,
                    "incomplete": 6, "not-external": 7,
                },
            })
        );
    }
}
