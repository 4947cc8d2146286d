//! The values in a message, one by one, for tables, CSV and JSON.

use std::{borrow::Cow, fmt};

/// A value in a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// No value.
    Absent,
    /// A truth value.
    Bool(bool),
    /// A count, a time or a code.
    Unsigned(u64),
    /// A signed integer.
    Signed(i64),
    /// A quantity.
    Float(f64),
    /// A name or a sentence.
    Text(Cow<'static, str>),
}

impl fmt::Display for Value {
    /// Writes nothing for an absent value, and a number as the shortest decimal that
    /// parses to the same number.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absent => Ok(()),
            Self::Bool(value) => write!(formatter, "{value}"),
            Self::Unsigned(value) => write!(formatter, "{value}"),
            Self::Signed(value) => write!(formatter, "{value}"),
            Self::Float(value) => write!(formatter, "{value:?}"),
            Self::Text(value) => formatter.write_str(value),
        }
    }
}

impl Value {
    /// Adds the text of [`fmt::Display`], several times as fast. Of two shortest decimals that are
    /// equally near to a number, it may be the other one.
    pub fn push_to(&self, text: &mut String) {
        match self {
            Self::Absent => {}
            Self::Bool(value) => text.push_str(if *value { "true" } else { "false" }),
            Self::Unsigned(value) => text.push_str(itoa::Buffer::new().format(*value)),
            Self::Signed(value) => text.push_str(itoa::Buffer::new().format(*value)),
            Self::Float(value) => push_float(text, *value),
            Self::Text(value) => text.push_str(value),
        }
    }
}

/// Adds the shortest decimal that parses to the same number, in the form of `{:?}` of the
/// standard library.
fn push_float(text: &mut String, value: f64) {
    let mut buffer = zmij::Buffer::new();
    let shown = buffer.format(value);
    // The ranges in which the two write the exponent differently.
    if (1e-5..1e-4).contains(&value.abs())
        && let Some((sign, digits)) = shown.split_once("0.0000")
    {
        let (first, rest) = digits.split_at(digits.len().min(1));
        let point = if rest.is_empty() { "" } else { "." };
        for part in [sign, first, point, rest, "e-5"] {
            text.push_str(part);
        }
    } else if value.abs() >= 1e16
        && let Some((digits, exponent)) = shown.split_once("e+")
    {
        for part in [digits, "e", exponent] {
            text.push_str(part);
        }
    } else {
        text.push_str(shown);
    }
}

/// Shows the element of a list with this index.
pub(crate) type Element<'a> = &'a dyn Fn(usize, &mut dyn Visitor);

/// Visits the fields of a message in the order of its schema.
pub(crate) trait Visitor {
    /// A value.
    fn value(&mut self, name: &str, value: Value);
    /// A message within the message. If it is not present, the values of its fields have no
    /// meaning.
    fn message(&mut self, name: &'static str, present: bool, fields: &dyn Fn(&mut dyn Visitor));
    /// A list of messages.
    fn list(&mut self, name: &'static str, length: usize, element: Element<'_>);
}

/// Collects the paths of all values, with dots between the names. They are the same for
/// every message of a type. A list counts as one value.
#[derive(Default)]
pub(crate) struct Paths {
    prefix: String,
    pub(crate) paths: Vec<String>,
}

impl Visitor for Paths {
    fn value(&mut self, name: &str, _: Value) {
        self.paths.push(format!("{}{name}", self.prefix));
    }

    fn message(&mut self, name: &'static str, _: bool, fields: &dyn Fn(&mut dyn Visitor)) {
        let length = self.prefix.len();
        self.prefix.push_str(name);
        self.prefix.push('.');
        fields(self);
        self.prefix.truncate(length);
    }

    fn list(&mut self, name: &'static str, _: usize, _: Element<'_>) {
        self.value(name, Value::Absent);
    }
}

/// Collects all values, in the order of their [`Paths`]. The value of a list is its length.
pub(crate) struct Values<'a> {
    absent: bool,
    values: &'a mut Vec<Value>,
}

impl<'a> Values<'a> {
    /// Appends to `values`.
    pub(crate) const fn new(values: &'a mut Vec<Value>) -> Self {
        Self {
            absent: false,
            values,
        }
    }
}

impl Visitor for Values<'_> {
    fn value(&mut self, _: &str, value: Value) {
        self.values
            .push(if self.absent { Value::Absent } else { value });
    }

    fn message(&mut self, _: &'static str, present: bool, fields: &dyn Fn(&mut dyn Visitor)) {
        let outer = self.absent;
        self.absent |= !present;
        fields(self);
        self.absent = outer;
    }

    fn list(&mut self, name: &'static str, length: usize, _: Element<'_>) {
        self.value(name, Value::Unsigned(length as u64));
    }
}

/// Writes a JSON object. An absent value and a number that is not finite are null.
pub(crate) struct Json<'a> {
    text: &'a mut String,
    first: bool,
}

impl<'a> Json<'a> {
    /// Writes one object with its braces.
    pub(crate) fn object(text: &'a mut String, fields: impl FnOnce(&mut Json<'_>)) {
        text.push('{');
        let mut json = Json { text, first: true };
        fields(&mut json);
        json.text.push('}');
    }

    /// Writes one object whose first field is the topic.
    pub(crate) fn entry(text: &'a mut String, topic: &str, fields: impl FnOnce(&mut Json<'_>)) {
        Self::object(text, |json| {
            json.put_text("topic", topic);
            fields(json);
        });
    }

    /// Adds a value.
    pub(crate) fn put(&mut self, name: &str, value: &Value) {
        self.key(name);
        match value {
            Value::Absent => self.text.push_str("null"),
            Value::Float(float) if !float.is_finite() => self.text.push_str("null"),
            Value::Text(text) => push_string(self.text, text),
            other => other.push_to(self.text),
        }
    }

    /// Adds a text.
    pub(crate) fn put_text(&mut self, name: &str, text: &str) {
        self.key(name);
        push_string(self.text, text);
    }

    fn key(&mut self, name: &str) {
        if !self.first {
            self.text.push(',');
        }
        self.first = false;
        self.text.push('"');
        self.text.push_str(name);
        self.text.push_str("\":");
    }
}

impl Visitor for Json<'_> {
    fn value(&mut self, name: &str, value: Value) {
        self.put(name, &value);
    }

    fn message(&mut self, name: &'static str, present: bool, fields: &dyn Fn(&mut dyn Visitor)) {
        self.key(name);
        if present {
            Json::object(self.text, |json| fields(json));
        } else {
            self.text.push_str("null");
        }
    }

    fn list(&mut self, name: &'static str, length: usize, element: Element<'_>) {
        self.key(name);
        self.text.push('[');
        for index in 0..length {
            if index > 0 {
                self.text.push(',');
            }
            Json::object(self.text, |json| element(index, json));
        }
        self.text.push(']');
    }
}

fn push_string(text: &mut String, value: &str) {
    // A text has a form in JSON.
    text.push_str(&serde_json::to_string(value).unwrap_or_default());
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn pushed(value: &Value) -> String {
        let mut text = String::new();
        value.push_to(&mut text);
        text
    }

    #[test]
    fn floats_are_written_as_the_standard_library_shows_them() {
        for float in [
            0.0,
            -0.0,
            1.0,
            0.1 + 0.2,
            1e-4,
            9.999e-5,
            -1.234e-5,
            1e-5,
            9.99e-6,
            1e15,
            9_999_999_999_999_998.0,
            1e16,
            1.5e300,
            f64::MIN_POSITIVE,
            5e-324,
            f64::MAX,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::NAN,
        ] {
            assert_eq!(pushed(&Value::Float(float)), format!("{float:?}"));
        }
    }

    fn value() -> impl Strategy<Value = Value> {
        prop_oneof![
            Just(Value::Absent),
            any::<bool>().prop_map(Value::Bool),
            any::<u64>().prop_map(Value::Unsigned),
            any::<i64>().prop_map(Value::Signed),
            any::<u64>().prop_map(|bits| Value::Float(f64::from_bits(bits))),
            (-1e3..1e3).prop_map(Value::Float),
            (-1e-3..1e-3).prop_map(Value::Float),
            any::<String>().prop_map(|text| Value::Text(text.into())),
        ]
    }

    /// Whether a number lies exactly in the middle of two shortest decimals, of which these are the
    /// two: libraries round such a tie differently.
    fn is_a_tie(value: f64, texts: [&str; 2]) -> bool {
        /// The longest exact decimal of any number has 767 digits.
        const ALL_DIGITS: usize = 800;
        let digits = |text: &str| {
            let mantissa = text.split('e').next().unwrap_or_default();
            let digits = mantissa.replace(['-', '.'], "");
            digits.trim_matches('0').to_owned()
        };
        let exact = digits(&format!("{value:.ALL_DIGITS$e}"));
        let longest = texts.map(|text| digits(text).len()).into_iter().max();
        exact.ends_with('5')
            && longest.map(|length| length + 1) == Some(exact.len())
            && texts.map(str::parse) == [Ok(value), Ok(value)]
    }

    #[test]
    fn a_number_in_the_middle_of_two_shortest_decimals_is_pushed_as_one_of_them() {
        // It ends in .25 exactly.
        let value = -996_099_882_495_302.3;
        let both = ["-996099882495302.2", "-996099882495302.3"];
        assert!(both.contains(&pushed(&Value::Float(value)).as_str()));
        assert!(is_a_tie(value, both));
        // It parses to the same number, but is not in the middle.
        assert!(!is_a_tie(0.3, ["0.3", "0.30000000000000002"]));
    }

    proptest! {
        #[test]
        fn every_value_is_pushed_as_it_is_displayed(value in value()) {
            let (text, shown) = (pushed(&value), value.to_string());
            let tie = matches!(value, Value::Float(value) if is_a_tie(value, [&text, &shown]));
            prop_assert!(text == shown || tie, "{text} for {shown}");
        }
    }
}
