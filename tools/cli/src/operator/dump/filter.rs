//! Chooses rows by time and by the values of their fields.

use std::{cmp::Ordering, str::FromStr};

use singletrack_record::Value;

use super::{
    DumpError,
    kind::{Kind, Place, check_field},
    source::Row,
    words::words,
};

/// A condition such as `mode=driving` or `lateness_ns>500000`.
#[derive(Clone, Debug)]
pub struct Condition {
    field: String,
    accepts: Operator,
    wanted: Wanted,
}

/// Whether it takes a value that compares so with the wanted one; none if the two can't be compared.
type Operator = fn(Option<Ordering>) -> bool;

/// The longer first: `<=` begins with `<`.
const OPERATORS: [(&str, Operator); 6] = [
    ("!=", |ordering| ordering != Some(Ordering::Equal)),
    ("<=", |ordering| ordering.is_some_and(Ordering::is_le)),
    (">=", |ordering| ordering.is_some_and(Ordering::is_ge)),
    ("=", |ordering| ordering == Some(Ordering::Equal)),
    ("<", |ordering| ordering == Some(Ordering::Less)),
    (">", |ordering| ordering == Some(Ordering::Greater)),
];

/// The value of a condition: as it is written, and as a number.
#[derive(Clone, Debug, PartialEq)]
struct Wanted {
    text: String,
    /// Exact, for times beyond 2^53.
    whole: Option<i128>,
    number: Option<f64>,
}

impl FromStr for Condition {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let none = || {
            format!(
                "not a condition: {text:?}; use FIELD=VALUE, or !=, <, <=, > or >= in place of = (in \
                 quotes, for the shell)"
            )
        };
        let at = text.find(['=', '!', '<', '>']).ok_or_else(none)?;
        let (field, rest) = text.split_at_checked(at).ok_or_else(none)?;
        let (sign, accepts, value) = OPERATORS
            .into_iter()
            .find_map(|(sign, accepts)| Some((sign, accepts, rest.strip_prefix(sign)?)))
            .ok_or_else(none)?;
        let (field, value) = (field.trim(), value.trim());
        if field.is_empty() {
            return Err(none());
        }
        let wanted = Wanted {
            text: value.to_owned(),
            whole: value.parse().ok(),
            number: value.parse().ok(),
        };
        if !matches!(sign, "=" | "!=") && wanted.number.is_none() {
            return Err(format!(
                "{field}{sign}{value}: {sign} compares with numbers, and {value:?} is not one; use = \
                 or !="
            ));
        }
        Ok(Self {
            field: field.to_owned(),
            accepts,
            wanted,
        })
    }
}

impl Condition {
    /// Whether this value of the field meets it.
    fn holds(&self, value: &Value) -> bool {
        (self.accepts)(self.wanted.compare(value))
    }

    /// Refuses a word that the field is never.
    fn check_word<'a>(&self, kinds: impl Iterator<Item = &'a Kind>) -> Result<(), DumpError> {
        let mut known: Vec<String> = Vec::new();
        for kind in kinds.filter(|kind| kind.place(&self.field).is_some()) {
            let words = words(kind.name, &self.field);
            // What is absent equals the two.
            let absent = ["", "none"].contains(&self.wanted.text.as_str());
            if words.is_empty() || absent || words.contains(&self.wanted.text) {
                return Ok(());
            }
            for word in words {
                if !known.contains(&word) {
                    known.push(word);
                }
            }
        }
        if known.is_empty() {
            return Ok(());
        }
        let (field, word, known) = (&self.field, &self.wanted.text, known.join(", "));
        let text = format!("{field} is never {word:?}; it is one of {known}");
        Err(DumpError::Other(text))
    }
}

impl Wanted {
    /// How a value compares; none if the two can't be compared.
    fn compare(&self, value: &Value) -> Option<Ordering> {
        match value {
            Value::Absent => matches!(self.text.as_str(), "" | "none").then_some(Ordering::Equal),
            Value::Bool(value) => {
                (self.text == if *value { "true" } else { "false" }).then_some(Ordering::Equal)
            }
            Value::Text(text) => (*text == self.text.as_str()).then_some(Ordering::Equal),
            Value::Unsigned(value) => self.compare_whole((*value).into()),
            Value::Signed(value) => self.compare_whole((*value).into()),
            Value::Float(value) => value.partial_cmp(&self.number?),
        }
    }

    fn compare_whole(&self, value: i128) -> Option<Ordering> {
        match self.whole {
            Some(whole) => Some(value.cmp(&whole)),
            None => (value as f64).partial_cmp(&self.number?),
        }
    }
}

/// All conditions, and for each kind of row where their fields are.
pub(super) struct Filter {
    conditions: Vec<Condition>,
    /// None for a kind without one of the fields: its rows are left out.
    places: Vec<Option<Vec<Place>>>,
    from_ns: Option<i64>,
    to_ns: Option<i64>,
}

/// Whether a row is printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It is.
    Take,
    /// It is not.
    Leave,
    /// It is not, and no later row is.
    Stop,
}

/// Rows are in order of time but for less than this.
const DISORDER_NS: i64 = 1_000_000_000;

impl Filter {
    pub(super) fn new(
        kinds: &[Kind],
        chosen: &[usize],
        conditions: Vec<Condition>,
    ) -> Result<Self, DumpError> {
        let chosen = chosen.iter().filter_map(|index| kinds.get(*index));
        for condition in &conditions {
            check_field(chosen.clone(), &condition.field)?;
            condition.check_word(chosen.clone())?;
        }
        let places = |kind: &Kind| {
            let fields = conditions.iter().map(|condition| &condition.field);
            fields.map(|field| kind.place(field)).collect()
        };
        Ok(Self {
            places: kinds.iter().map(places).collect(),
            conditions,
            from_ns: None,
            to_ns: None,
        })
    }

    /// Rows from then to then alone, in ns since the start.
    pub(super) fn within(self, from_ns: Option<i64>, to_ns: Option<i64>) -> Self {
        Self {
            from_ns,
            to_ns,
            ..self
        }
    }

    /// Whether it needs the values of the fields.
    pub(super) fn needs_values(&self) -> bool {
        !self.conditions.is_empty()
    }

    /// Judges the row by its time.
    pub(super) fn judge_time(&self, row: &Row) -> Verdict {
        if self.from_ns.is_none() && self.to_ns.is_none() {
            return Verdict::Take;
        }
        let Some(time_ns) = row.time_ns else {
            return Verdict::Leave;
        };
        match self.to_ns {
            Some(to_ns) if time_ns > to_ns.saturating_add(DISORDER_NS) => Verdict::Stop,
            Some(to_ns) if time_ns > to_ns => Verdict::Leave,
            _ if self.from_ns.is_some_and(|from_ns| time_ns < from_ns) => Verdict::Leave,
            _ => Verdict::Take,
        }
    }

    /// Whether the row meets all conditions.
    pub(super) fn accepts(&self, row: &Row, values: &[Value]) -> bool {
        let Some(Some(places)) = self.places.get(row.kind) else {
            return false;
        };
        let time = row.time();
        let mut conditions = self.conditions.iter().zip(places);
        conditions.all(|(condition, place)| condition.holds(place.value(&time, values)))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    fn holds(condition: &str, value: &Value) -> bool {
        let condition: Condition = condition.parse().unwrap();
        condition.holds(value)
    }

    #[test]
    fn values_are_compared_as_what_they_are() {
        let large = Value::Unsigned((1 << 60) + 1);
        for (condition, value, expected) in [
            ("mode=driving", Value::Text("driving".into()), true),
            ("mode!=driving", Value::Text("idle".into()), true),
            ("mode=driving", Value::Absent, false),
            ("reason=none", Value::Absent, true),
            ("reason!=none", Value::Text("requested".into()), true),
            ("held=true", Value::Bool(true), true),
            ("held = false", Value::Bool(true), false),
            ("x<0.5", Value::Float(0.25), true),
            ("x>=0.25", Value::Float(0.25), true),
            ("x<0.5", Value::Float(f64::NAN), false),
            ("x<0.5", Value::Absent, false),
            ("n>-3", Value::Signed(-2), true),
            ("n<=2.5", Value::Signed(2), true),
            // One apart, where floating-point numbers are 256 apart.
            ("t=1152921504606846977", large.clone(), true),
            ("t>1152921504606846976", large.clone(), true),
            ("t!=1152921504606846976", large, true),
        ] {
            assert_eq!(
                holds(condition, &value),
                expected,
                "{condition} of {value:?}"
            );
        }
    }

    #[test]
    fn what_is_no_condition_is_refused() {
        for (text, expected) in [
            ("mode", "use FIELD=VALUE"),
            ("=driving", "use FIELD=VALUE"),
            ("mode!driving", "use FIELD=VALUE"),
            ("mode<driving", "mode<driving: < compares with numbers"),
        ] {
            let error = text.parse::<Condition>().unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
