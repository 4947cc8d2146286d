//! The parts of a message, one by one: what tables, CSV and JSON are made of.

use std::{borrow::Cow, fmt};

/// A part of a message that has no parts itself.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// There is none.
    Absent,
    /// Yes or no.
    Bool(bool),
    /// A count, a time or a code.
    Unsigned(u64),
    /// A whole number.
    Signed(i64),
    /// A quantity.
    Float(f64),
    /// A name or a sentence.
    Text(Cow<'static, str>),
}

impl fmt::Display for Value {
    /// Nothing for what is absent; numbers as the shortest decimal that reads
    /// back as the same number.
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

/// Walks through a message in the order of its schema.
pub(crate) trait Visitor {
    /// A part without parts.
    fn value(&mut self, name: &str, value: Value);
    /// A message within the message. Its fields mean nothing if it is not present.
    fn message(&mut self, name: &'static str, present: bool, fields: &dyn Fn(&mut dyn Visitor));
    /// A list of messages.
    fn list(
        &mut self,
        name: &'static str,
        length: usize,
        element: &dyn Fn(usize, &mut dyn Visitor),
    );
}

/// The paths of all parts, joined with dots: the same for every message of a
/// kind. A list counts as one part.
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

    fn list(&mut self, name: &'static str, _: usize, _: &dyn Fn(usize, &mut dyn Visitor)) {
        self.value(name, Value::Absent);
    }
}

/// All parts, in the order of their [`Paths`]; of a list, its length.
#[derive(Default)]
pub(crate) struct Values {
    absent: bool,
    pub(crate) values: Vec<Value>,
}

impl Visitor for Values {
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

    fn list(&mut self, name: &'static str, length: usize, _: &dyn Fn(usize, &mut dyn Visitor)) {
        self.value(name, Value::Unsigned(length as u64));
    }
}

/// A JSON object, without its closing brace. What is absent or no number is null.
pub(crate) struct Json<'a> {
    pub(crate) text: &'a mut String,
    first: bool,
}

impl<'a> Json<'a> {
    /// Writes the fields of one object, braces and all.
    pub(crate) fn object(text: &'a mut String, fields: impl FnOnce(&mut Json<'_>)) {
        text.push('{');
        let mut json = Json { text, first: true };
        fields(&mut json);
        json.text.push('}');
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
        self.key(name);
        match value {
            Value::Absent => self.text.push_str("null"),
            Value::Float(float) if !float.is_finite() => self.text.push_str("null"),
            Value::Text(text) => push_string(self.text, &text),
            number => self.text.push_str(&number.to_string()),
        }
    }

    fn message(&mut self, name: &'static str, present: bool, fields: &dyn Fn(&mut dyn Visitor)) {
        self.key(name);
        if present {
            Json::object(self.text, |json| fields(json));
        } else {
            self.text.push_str("null");
        }
    }

    fn list(
        &mut self,
        name: &'static str,
        length: usize,
        element: &dyn Fn(usize, &mut dyn Visitor),
    ) {
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
    text.push('"');
    for character in value.chars() {
        match character {
            '"' => text.push_str("\\\""),
            '\\' => text.push_str("\\\\"),
            '\n' => text.push_str("\\n"),
            '\r' => text.push_str("\\r"),
            '\t' => text.push_str("\\t"),
            control if control < ' ' => {
                text.push_str(&format!("\\u{:04x}", u32::from(control)));
            }
            other => text.push(other),
        }
    }
    text.push('"');
}
