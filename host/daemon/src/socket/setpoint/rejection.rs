//! The count of the set-points that have no effect.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;
use singletrack_api::{Code, is_too_large};
use singletrack_pilot::SetpointRefusal;

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

impl SetpointFigures {
    pub(super) fn reject(&mut self, why: Code) {
        *self.rejected.entry(why.name()).or_default() += 1;
    }

    /// The pilot refused one that was accepted.
    pub(crate) fn refuse(&mut self, why: SetpointRefusal) {
        *self.refused.entry(why.name()).or_default() += 1;
    }
}

/// Why a line that does not parse is rejected as a set-point; `None` if it is none.
///
/// JSON has no word for what is not finite. Programs write `NaN` or `Infinity`, which is no
/// JSON, `null`, or a number that is too large.
pub(in crate::socket) fn unreadable(line: &[u8]) -> Option<Code> {
    let contains = |part: &[u8]| line.windows(part.len()).any(|window| window == part);
    contains(b"\"setpoint\"").then(|| {
        let is_number = match serde_json::from_slice::<Value>(line) {
            Ok(Value::Object(keys)) => keys.values().any(has_null),
            Ok(_) => false,
            Err(error) => is_too_large(&error),
        };
        let is_word = [&b"NaN"[..], b"nan", b"Infinity", b"inf"];
        if is_number || is_word.into_iter().any(contains) {
            Code::NotFinite
        } else {
            Code::Invalid
        }
    })
}

/// Whether it is a list with null in the place of a number. The null of a key counts as left out.
fn has_null(value: &Value) -> bool {
    match value {
        Value::Array(values) => values
            .iter()
            .any(|value| value.is_null() || has_null(value)),
        Value::Object(keys) => keys
            .values()
            .any(|value| value.is_null() || has_null(value)),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn every_rejection_and_refusal_is_counted_by_its_word() {
        let mut figures = SetpointFigures::default();
        let codes = [
            Code::Invalid,
            Code::NotFinite,
            Code::OutOfRange,
            Code::Future,
            Code::Old,
            Code::Sequence,
            Code::OtherSource,
            Code::NotExternal,
        ];
        for (count, why) in (1..).zip(codes) {
            for _ in 0..count {
                figures.reject(why);
            }
        }
        for (count, why) in (1..).zip(SetpointRefusal::ALL) {
            for _ in 0..count {
                figures.refuse(why);
            }
        }
        assert_eq!(
            serde_json::to_value(figures).unwrap(),
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
