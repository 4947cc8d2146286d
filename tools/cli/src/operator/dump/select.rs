//! Topics, fields, conditions and times: what the command line chooses among the rows.

use std::{cmp::Ordering, fmt, mem, ops::RangeInclusive, str::FromStr};

use jiff::Timestamp;
use singletrack_record::{Topic, Value};

use super::{
    DumpArgs,
    source::{About, Kind, Row, TIME},
};
use crate::Result;

/// Chooses the kinds with these names; all if there are no names.
pub(super) fn choose(kinds: &mut [Kind], names: &[String]) -> Result<(), String> {
    let unknown = |name: &&String| !kinds.iter().any(|kind| kind.is_named(name));
    if let Some(name) = names.iter().find(unknown) {
        let known: Vec<_> = kinds.iter().map(|kind| kind.name).collect();
        let topics = suggested(name, &known, ": use");
        return Err(format!("there is no topic {topics}"));
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
    let own = chosen.iter().flat_map(|kind| kind.own_fields());
    let known = distinct(own.map(String::as_str).chain([TIME]));
    let topics: Vec<_> = chosen.iter().map(|kind| kind.name).collect();
    let fields = suggested(name, &known, "; its fields are");
    Err(format!("{} has no field {fields}", topics.join(", ")))
}

/// The items without repetitions, in their order.
fn distinct<T: PartialEq>(items: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut known = Vec::new();
    for item in items {
        if !known.contains(&item) {
            known.push(item);
        }
    }
    known
}

/// The name, with a question for the one that was probably meant if one is near, and all known ones
/// after these words.
fn suggested(name: &str, known: &[&str], words: &str) -> String {
    let near = nearest(name, known).map(|name| format!(" (did you mean {name:?}?)"));
    let near = near.unwrap_or_default();
    format!("{name:?}{near}{words} {}", known.join(", "))
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
    let measured = known.iter().map(|known| (known, alike(known)));
    let most_alike = measured.max_by(|(_, a), (_, b)| a.total_cmp(b));
    let most_alike = most_alike.filter(|(_, alike)| *alike >= ALIKE);
    let near = || most_alike.map(|(known, _)| known);
    known.iter().find(contained).or_else(near).copied()
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
    let lines = schema.lines().take_while(|line| !line.starts_with('='));
    let mut constants = Vec::new();
    for (_, name) in lines.filter_map(|line| line.trim().split_once(' ')) {
        match name.split_once('=') {
            Some((constant, _)) => constants.push(constant),
            None if name == field => break,
            None => constants.clear(),
        }
    }
    let first = constants.first().copied().unwrap_or_default();
    let ends = first.rmatch_indices('_');
    let mut beginnings = ends.filter_map(|(at, _)| first.get(..=at));
    let shared = |beginning: &&str| constants.iter().all(|name| name.starts_with(beginning));
    let prefix = beginnings.find(shared).unwrap_or_default();
    let word = |name: &&str| name.strip_prefix(prefix).unwrap_or(name).to_lowercase();
    let words = constants.iter().map(word);
    words.map(|word| word.replace('_', "-")).collect()
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
        let at = text.find(['=', '!', '<', '>']).unwrap_or_default();
        let (field, rest) = text.split_at(at);
        let field = field.trim();
        let found = OPERATORS
            .into_iter()
            .find_map(|(sign, accepts)| Some((sign, accepts, rest.strip_prefix(sign)?.trim())));
        let Some((sign, accepts, value)) = found.filter(|_| !field.is_empty()) else {
            return Err(format!(
                "not a condition: {text:?}; use FIELD=VALUE, or !=, <, <=, > or >= in place of = (in \
                 quotes, for the shell)"
            ));
        };
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
        let has_field = |kind: &&Kind| kind.chosen && kind.index(field).is_some();
        let kinds = kinds.iter().filter(has_field);
        let lists: Vec<_> = kinds.map(|kind| words(kind.name, field)).collect();
        let accepts = |words: &Vec<String>| words.is_empty() || words.contains(wanted);
        // An absent value equals these two.
        if ["", "none"].contains(&wanted.as_str()) || lists.iter().any(accepts) {
            return Ok(());
        }
        let known = distinct(lists.concat()).join(", ");
        Err(format!("{field} is never {wanted:?}; it is one of {known}"))
    }
}

/// From the first to the last time, in ns since the start.
type Range = RangeInclusive<i64>;

/// All conditions, and for each kind the places of their fields.
pub(super) struct Filter<'a> {
    kinds: &'a [Kind],
    conditions: &'a [Condition],
    /// None for a kind without one of the fields: its rows are left out.
    places: Vec<Option<Vec<usize>>>,
    /// Whose rows are taken; all if there is none.
    pub(super) range: Option<Range>,
}

/// Rows are in order of time but for less than this.
const DISORDER_NS: i64 = 1_000_000_000;

impl<'a> Filter<'a> {
    pub(super) fn new(kinds: &'a [Kind], conditions: &'a [Condition]) -> Result<Self, String> {
        for condition in conditions {
            check_field(kinds, &condition.field)?;
            condition.check_word(kinds)?;
        }
        let places = |kind: &Kind| {
            let fields = conditions.iter().map(|condition| &condition.field);
            fields.map(|field| kind.index(field)).collect()
        };
        Ok(Self {
            kinds,
            conditions,
            places: kinds.iter().map(places).collect(),
            range: None,
        })
    }

    /// Whether the row is of a chosen kind and within the range; none if no row after it is within the
    /// range. One without a time is within no range.
    pub(super) fn covers(&self, row: &Row<'_>) -> Option<bool> {
        let is_chosen = self.kinds.get(row.kind).is_some_and(|kind| kind.chosen);
        match (&self.range, row.time_ns) {
            (Some(range), Some(time_ns)) if is_chosen => {
                let is_over = time_ns > range.end().saturating_add(DISORDER_NS);
                (!is_over).then(|| range.contains(&time_ns))
            }
            (Some(_), _) => Some(false),
            (None, _) => Some(is_chosen),
        }
    }

    /// Whether the row meets all conditions. Reads its values if there are any.
    pub(super) fn accepts(&self, row: &mut Row<'_>, values: &mut Vec<Value>) -> Result<bool> {
        let Some(Some(places)) = self.places.get(row.kind) else {
            return Ok(false);
        };
        if !self.conditions.is_empty() {
            row.read_values(values)?;
        }
        let value = |place: &usize| values.get(*place).unwrap_or(&Value::Absent);
        let mut conditions = self.conditions.iter().zip(places);
        Ok(conditions.all(|(condition, place)| condition.holds(value(place))))
    }
}

/// A time within a record.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub enum Moment {
    /// Seconds after the start of the record.
    Seconds(f64),
    /// On the wall.
    Wall(Timestamp),
}

impl FromStr for Moment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse::<f64>() {
            Ok(seconds) if (0.0..f64::INFINITY).contains(&seconds) => Ok(Self::Seconds(seconds)),
            Ok(seconds) if seconds.is_finite() => {
                Err("there is nothing before the start: give 0 or more seconds".to_owned())
            }
            _ => wall(text).map(Self::Wall).ok_or_else(|| {
                format!(
                    "not a time: {text:?}; use seconds since the start (12.5), or date, time and zone \
                     (2026-11-21T12:00:00.5Z, 2026-11-21T13:00:00+01:00)"
                )
            }),
        }
    }
}

impl fmt::Display for Moment {
    /// Seconds, or date and time in UTC.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Seconds(seconds) => write!(formatter, "{seconds}"),
            Self::Wall(time) => write!(formatter, "{time}"),
        }
    }
}

impl Moment {
    /// Whether it is after the other; false if one has seconds and the other a date.
    fn is_after(self, other: Self) -> bool {
        mem::discriminant(&self) == mem::discriminant(&other) && self > other
    }

    /// The moment in ns since a start at `start_wall_ns`; none if it is on the
    /// wall and the start is not known there.
    fn since(self, start_wall_ns: Option<u64>) -> Option<i64> {
        match self {
            // Saturates, which is as good as never or ever.
            Self::Seconds(seconds) => Some((seconds * 1e9) as i64),
            Self::Wall(time) => {
                let since_ns = time.as_nanosecond() - i128::from(start_wall_ns?);
                Some(since_ns.clamp(i64::MIN.into(), i64::MAX.into()) as i64)
            }
        }
    }
}

/// ISO 8601 with a zone: `2026-11-21T12:00:00.25+01:00`.
fn wall(text: &str) -> Option<Timestamp> {
    let offset = text.rfind(['+', '-']).and_then(|sign| text.get(sign + 1..));
    // An offset has its colon, as in RFC 3339; the library accepts it without.
    if offset.is_some_and(|offset| offset.len() == 4) {
        return None;
    }
    // What fits into 64 bits of ns: 1677 to 2262.
    let is_near = |time: &Timestamp| i64::try_from(time.as_nanosecond()).is_ok();
    text.parse().ok().filter(is_near)
}

/// The times of the first and the last row in seconds, and the same times on the wall.
fn span_text((start_wall_ns, span_ns): (u64, [i64; 2])) -> String {
    // To a millisecond, as the seconds.
    let wall = |ns| {
        let ms = (i128::from(start_wall_ns) + i128::from(ns)) / 1_000_000;
        Timestamp::from_nanosecond(ms * 1_000_000).unwrap_or_default()
    };
    let [first_s, last_s] = span_ns.map(|ns| ns as f64 / 1e9);
    let [first, last] = span_ns.map(wall);
    format!("{first_s:.3} s to {last_s:.3} s ({first} to {last})")
}

/// Refuses a range that ends before it begins, as far as that is known without the source.
pub(super) fn check_order(args: &DumpArgs) -> Result<(), String> {
    match args.from.zip(args.to) {
        Some((from, to)) if from.is_after(to) => Err(backwards(from, to, "")),
        _ => Ok(()),
    }
}

/// The range in ns since the start of the source; none if neither end is given. One without an entry
/// of the source is refused.
pub(super) fn range(args: &DumpArgs, source: &About, name: &str) -> Result<Option<Range>, String> {
    let (from, to) = (args.from, args.to);
    let (start_wall_ns, span_ns) = (source.start.map(|start| start.wall_ns), source.span_ns);
    let since = |option: &str, moment: Option<Moment>| match moment {
        None => Ok(None),
        Some(moment) => moment.since(start_wall_ns).map(Some).ok_or_else(|| {
            format!("{name} holds no wall time: give --{option} in seconds since its start")
        }),
    };
    let (from_ns, to_ns) = (since("from", from)?, since("to", to)?);
    let span = start_wall_ns.zip(span_ns).map(span_text);
    let span = span.unwrap_or_default();
    // One may be a date and the other a number of seconds.
    if let Some((from, to)) = from.zip(to)
        && from_ns > to_ns
    {
        let of_record = format!("; the entries of the record are from {span}");
        let of_record = if span.is_empty() { "" } else { &of_record };
        return Err(backwards(from, to, of_record));
    }
    let [first_ns, last_ns] = span_ns.unwrap_or([i64::MIN, i64::MAX]);
    let late = from_ns > Some(last_ns);
    let early = to_ns.is_some_and(|ns| ns < first_ns);
    for (option, moment, is_outside) in [("from", from, late), ("to", to, early)] {
        if let Some(moment) = moment.filter(|_| is_outside) {
            return Err(format!(
                "--{option} {moment} leaves nothing of {name}: its entries are from {span}"
            ));
        }
    }
    let is_given = from_ns.or(to_ns).is_some();
    Ok(is_given.then(|| from_ns.unwrap_or(i64::MIN)..=to_ns.unwrap_or(i64::MAX)))
}

/// The range ends before it begins; `of_record` names the times of the record.
fn backwards(from: Moment, to: Moment, of_record: &str) -> String {
    format!("--from {from} is after --to {to}: give the earlier time to --from{of_record}")
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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod moment_tests {
    use super::*;

    #[test]
    fn seconds_and_dates_are_understood() {
        let wall = |seconds, ns| Moment::Wall(Timestamp::new(seconds, ns).unwrap());
        for (text, expected) in [
            ("12.5", Moment::Seconds(12.5)),
            ("0", Moment::Seconds(0.0)),
            ("1970-01-01T00:00:00Z", wall(0, 0)),
            ("2000-02-29T00:00:00Z", wall(951_782_400, 0)),
            ("2000-03-01T00:00:00Z", wall(951_868_800, 0)),
            ("2026-11-21T12:00:00.25Z", wall(1_795_262_400, 250_000_000)),
            ("2026-11-21 13:00:00+01:00", wall(1_795_262_400, 0)),
            ("2026-11-21T03:30-0830", wall(0, 0)),
        ] {
            if text.ends_with("0830") {
                // RFC 3339 has a colon in the zone.
                assert!(text.parse::<Moment>().is_err());
            } else {
                assert_eq!(text.parse::<Moment>().unwrap(), expected, "{text}");
            }
        }
    }

    #[test]
    fn what_is_no_moment_is_refused_with_what_would_be() {
        for text in [
            "",
            "soon",
            "inf",
            "NaN",
            "2026-11-21",
            "2026-11-21T12:00:00",
            "2026-13-21T12:00:00Z",
            "2026-11-21T25:00:00Z",
            "2026-11-21T12:00:00.Z",
            "2026-11-21T12:00:00+é1:00",
        ] {
            let error = text.parse::<Moment>().unwrap_err().to_string();
            assert!(error.contains("use seconds since the start"), "{error}");
        }
    }

    #[test]
    fn there_is_nothing_before_the_start() {
        for text in ["-1", "-0.001"] {
            let error = text.parse::<Moment>().unwrap_err();
            assert!(error.contains("nothing before the start"), "{error}");
        }
    }

    #[test]
    fn moments_of_a_kind_are_ordered_and_print_as_they_are_written() {
        let moment = |text: &str| text.parse::<Moment>().unwrap();
        let (early, late) = (
            moment("2026-11-21T12:00:00Z"),
            moment("2026-11-21T14:00:00+01:00"),
        );
        assert!(late.is_after(early) && !early.is_after(late) && !early.is_after(early));
        assert!(moment("10").is_after(moment("5")) && !moment("10").is_after(early));
        assert_eq!(late.to_string(), "2026-11-21T13:00:00Z");
        assert_eq!(moment("12.50").to_string(), "12.5");
    }

    #[test]
    fn a_moment_on_the_wall_needs_a_start_on_the_wall() {
        assert_eq!(Moment::Seconds(1.5).since(None), Some(1_500_000_000));
        let wall = Moment::Wall(Timestamp::from_nanosecond(1_000).unwrap());
        assert_eq!(wall.since(None), None);
        assert_eq!(wall.since(Some(400)), Some(600));
    }
}
