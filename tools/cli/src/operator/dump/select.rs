//! Topics, fields and conditions: what the command line chooses among the rows.

use std::{cmp::Ordering, str::FromStr};

use singletrack_record::{Topic, Value};

use super::source::{Kind, Row, TIME};

/// Chooses the kinds with these names; all if there are no names.
pub(super) fn choose(kinds: &mut [Kind], names: &[String]) -> Result<(), String> {
    let unknown = |name: &&String| !kinds.iter().any(|kind| kind.is_named(name));
    if let Some(name) = names.iter().find(unknown) {
        let known: Vec<_> = kinds.iter().map(|kind| kind.name).collect();
        return Err(format!(
            "there is no topic {name:?}{}: use {}",
            near(name, &known),
            known.join(", ")
        ));
    }
    for kind in kinds {
        kind.chosen = names.is_empty() || names.iter().any(|name| kind.is_named(name));
    }
    Ok(())
}

/// Refuses a field that none of the chosen kinds has.
pub(super) fn check_field(kinds: &[Kind], name: &str) -> Result<(), String> {
    let chosen: Vec<_> = kinds.iter().filter(|kind| kind.chosen).collect();
    if chosen.iter().any(|kind| kind.index(name).is_some()) {
        return Ok(());
    }
    let mut known: Vec<&str> = Vec::new();
    for field in chosen.iter().flat_map(|kind| kind.own_fields()) {
        if !known.contains(&field.as_str()) {
            known.push(field);
        }
    }
    known.push(TIME);
    let topics: Vec<_> = chosen.iter().map(|kind| kind.name).collect();
    Err(format!(
        "{} has no field {name:?}{}; its fields are {}",
        topics.join(", "),
        near(name, &known),
        known.join(", ")
    ))
}

/// A question for the name that was probably meant, if one is near.
fn near(name: &str, known: &[&str]) -> String {
    nearest(name, known).map_or_else(String::new, |name| format!(" (did you mean {name:?}?)"))
}

/// The name that was probably meant: one that contains it, or one that differs by little, in whole
/// or in its last part.
fn nearest<'a>(name: &str, known: &[&'a str]) -> Option<&'a str> {
    const ALIKE: f64 = 0.6;
    let contained = |known: &&&str| known.contains(name) || name.contains(**known);
    let alike = |known: &str| {
        let last = known.rsplit('.').next().unwrap_or(known);
        strsim::normalized_damerau_levenshtein(name, known)
            .max(strsim::normalized_damerau_levenshtein(name, last))
    };
    let most_alike = || {
        let measured = known.iter().map(|known| (known, alike(known)));
        let near = measured.filter(|(_, alike)| *alike >= ALIKE);
        near.max_by(|(_, a), (_, b)| a.total_cmp(b))
            .map(|(known, _)| known)
    };
    known.iter().find(contained).or_else(most_alike).copied()
}

/// The words of a field that holds one of a few, by the schema of its topic; empty for
/// any other field.
fn words(topic: &str, field: &str) -> Vec<String> {
    let Ok(topic) = topic.parse::<Topic>() else {
        return Vec::new();
    };
    // The constants of a field stand before it: `uint8 MODE_DRIVING=6`, ..., `uint8 mode`.
    // Other messages, after the line of `=`, are those within this one.
    let schema = topic.schema_text();
    let mut constants = Vec::new();
    for line in schema.lines().take_while(|line| !line.starts_with('=')) {
        let Some((_, name)) = line.trim().split_once(' ') else {
            continue;
        };
        match name.split_once('=') {
            Some((constant, _)) => constants.push(constant),
            None if name == field => break,
            None => constants.clear(),
        }
    }
    let first = constants.first().copied().unwrap_or_default();
    let mut beginnings = first
        .match_indices('_')
        .filter_map(|(at, _)| first.get(..=at));
    let shared = |beginning: &&str| constants.iter().all(|name| name.starts_with(beginning));
    let prefix = beginnings.rfind(shared).unwrap_or_default();
    constants
        .iter()
        .map(|name| {
            name.strip_prefix(prefix)
                .unwrap_or(name)
                .to_lowercase()
                .replace('_', "-")
        })
        .collect()
}

/// A condition such as `mode=driving` or `lateness_ns>500000`.
#[derive(Clone, Debug)]
pub struct Condition {
    field: String,
    accepts: Operator,
    /// The wanted value as it is written.
    wanted: String,
    /// The wanted value as an integer: exact, for times beyond 2^53.
    whole: Option<i128>,
    /// The wanted value as a number.
    number: Option<f64>,
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
        let condition = Self {
            field: field.to_owned(),
            accepts,
            wanted: value.to_owned(),
            whole: value.parse().ok(),
            number: value.parse().ok(),
        };
        if !matches!(sign, "=" | "!=") && condition.number.is_none() {
            return Err(format!(
                "{field}{sign}{value}: {sign} compares with numbers, and {value:?} is not one; use = \
                 or !="
            ));
        }
        Ok(condition)
    }
}

impl Condition {
    /// Whether this value of the field meets it.
    fn holds(&self, value: &Value) -> bool {
        let equal_if = |equal: bool| equal.then_some(Ordering::Equal);
        let compare_whole = |value: i128| match self.whole {
            Some(whole) => Some(value.cmp(&whole)),
            None => (value as f64).partial_cmp(&self.number?),
        };
        (self.accepts)(match value {
            Value::Absent => equal_if(matches!(self.wanted.as_str(), "" | "none")),
            Value::Bool(value) => equal_if(self.wanted == if *value { "true" } else { "false" }),
            Value::Text(text) => equal_if(*text == self.wanted.as_str()),
            Value::Unsigned(value) => compare_whole((*value).into()),
            Value::Signed(value) => compare_whole((*value).into()),
            Value::Float(value) => self.number.and_then(|number| value.partial_cmp(&number)),
        })
    }

    /// Refuses a word that the field never has in the chosen kinds.
    fn check_word(&self, kinds: &[Kind]) -> Result<(), String> {
        let Self { field, wanted, .. } = self;
        let mut known: Vec<String> = Vec::new();
        let has_field = |kind: &&Kind| kind.chosen && kind.index(field).is_some();
        for kind in kinds.iter().filter(has_field) {
            let words = words(kind.name, field);
            // An absent value equals these two.
            let absent = ["", "none"].contains(&wanted.as_str());
            if words.is_empty() || absent || words.contains(wanted) {
                return Ok(());
            }
            let new: Vec<_> = words
                .into_iter()
                .filter(|word| !known.contains(word))
                .collect();
            known.extend(new);
        }
        if known.is_empty() {
            return Ok(());
        }
        Err(format!(
            "{field} is never {wanted:?}; it is one of {}",
            known.join(", ")
        ))
    }
}

/// All conditions, and for each kind the places of their fields.
pub(super) struct Filter<'a> {
    conditions: &'a [Condition],
    /// None for a kind without one of the fields: its rows are left out.
    places: Vec<Option<Vec<usize>>>,
    /// The first and the last time, in ns since the start.
    pub(super) range: (Option<i64>, Option<i64>),
}

/// Rows are in order of time but for less than this.
const DISORDER_NS: i64 = 1_000_000_000;

impl<'a> Filter<'a> {
    pub(super) fn new(kinds: &[Kind], conditions: &'a [Condition]) -> Result<Self, String> {
        for condition in conditions {
            check_field(kinds, &condition.field)?;
            condition.check_word(kinds)?;
        }
        let places = |kind: &Kind| {
            let fields = conditions.iter().map(|condition| &condition.field);
            fields.map(|field| kind.index(field)).collect()
        };
        Ok(Self {
            places: kinds.iter().map(places).collect(),
            conditions,
            range: (None, None),
        })
    }

    /// Whether it needs the values of the fields.
    pub(super) const fn needs_values(&self) -> bool {
        !self.conditions.is_empty()
    }

    /// Whether no row after this one is within the range.
    pub(super) fn is_over(&self, row: &Row) -> bool {
        let (_, to_ns) = self.range;
        let ends = row.time_ns.zip(to_ns);
        ends.is_some_and(|(time_ns, to_ns)| time_ns > to_ns.saturating_add(DISORDER_NS))
    }

    /// Whether the row is within the range. One without a time is within no range.
    pub(super) fn covers(&self, row: &Row) -> bool {
        match (self.range, row.time_ns) {
            ((None, None), _) => true,
            (_, None) => false,
            ((from_ns, to_ns), Some(time_ns)) => {
                from_ns.is_none_or(|from_ns| time_ns >= from_ns)
                    && to_ns.is_none_or(|to_ns| time_ns <= to_ns)
            }
        }
    }

    /// Whether a row of this kind meets all conditions.
    pub(super) fn accepts(&self, kind: usize, values: &[Value]) -> bool {
        let Some(Some(places)) = self.places.get(kind) else {
            return false;
        };
        let mut conditions = self.conditions.iter().zip(places);
        conditions
            .all(|(condition, place)| condition.holds(values.get(*place).unwrap_or(&Value::Absent)))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use singletrack_pilot::{Mode, Reason};

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

    #[test]
    fn the_field_that_was_meant_is_found() {
        let known = ["tick", "estimate.yaw_rad", "yaw_rate_mrad_s", "lateness_ns"];
        for (name, expected) in [
            ("yaw_rate", Some("yaw_rate_mrad_s")),
            ("yaw_rda", Some("estimate.yaw_rad")),
            ("latenes_ns", Some("lateness_ns")),
            ("colour", None),
        ] {
            assert_eq!(nearest(name, &known), expected, "{name}");
        }
    }

    #[test]
    fn the_words_of_a_field_are_those_that_its_values_print() {
        let sorted = |mut words: Vec<String>| {
            words.sort();
            words
        };
        let modes = Mode::ALL.iter().map(|mode| mode.name().to_owned());
        assert_eq!(sorted(words("tick", "mode")), sorted(modes.collect()));
        let reasons = Reason::ALL.iter().map(|reason| reason.name().to_owned());
        let reasons = reasons.chain(["none".to_owned()]);
        assert_eq!(sorted(words("tick", "reason")), sorted(reasons.collect()));
    }

    #[test]
    fn every_list_of_words_of_the_board_is_whole() {
        assert_eq!(
            words("telemetry", "mode"),
            [
                "boot",
                "neutral",
                "armed",
                "driving",
                "failsafe",
                "emergency-stopped",
                "powering-up",
                "jogging"
            ]
        );
        for (topic, field, word) in [
            ("telemetry", "stop_cause", "stop-input"),
            ("telemetry", "imu", "fresh"),
            ("status", "last_refusal", "none"),
            ("tick", "link", "ready"),
            ("pose", "state", "valid"),
            ("log", "level", "warning"),
        ] {
            let words = words(topic, field);
            assert!(
                words.iter().any(|known| known == word),
                "{field}: {words:?}"
            );
        }
    }

    #[test]
    fn numbers_texts_and_frames_have_no_words() {
        for (topic, field) in [("tick", "tick"), ("log", "text"), ("hello", "mode")] {
            assert_eq!(words(topic, field), [""; 0], "{topic} {field}");
        }
    }
}
