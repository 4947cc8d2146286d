//! Entries as lines of JSON: the daemon writes them, whoever watches reads them.

use std::borrow::Cow;

use crate::{Entry, Topic, Value, value::Json as Writer};

/// Adds one object to `json`, without a line end: the topic, then fields under
/// their paths, such as `{"topic":"tick","estimate.yaw_rad":0.3}`.
pub fn write_json_object<'a>(
    json: &mut String,
    topic: &str,
    fields: impl IntoIterator<Item = (&'a str, &'a Value)>,
) {
    Writer::entry(json, topic, |object| {
        for (path, value) in fields {
            object.put(path, value);
        }
    });
}

/// What a line of JSON shows: an entry as far as a table goes.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// The kind of entry.
    pub topic: Topic,
    /// Its fields, in the order of [`Topic::fields`], as [`Entry::values`] gives
    /// them.
    pub values: Vec<Value>,
}

/// A line does not show an entry.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotAnEntry {
    /// It is not an object in JSON.
    #[error("not a JSON object ({reason}): {line}")]
    NotJson {
        /// The line.
        line: String,
        /// Why not.
        reason: String,
    },
    /// It has no topic, or one that is not known.
    #[error("without a known topic: {line}")]
    NoTopic {
        /// The line.
        line: String,
    },
}

impl From<&Entry> for Shown {
    fn from(entry: &Entry) -> Self {
        Self {
            topic: entry.topic(),
            values: entry.values(),
        }
    }
}

impl Shown {
    /// Reads what [`Entry::write_json`] wrote. A field that is missing is absent:
    /// the writer may be of another release.
    ///
    /// # Errors
    ///
    /// When the line is no object or has no known topic.
    pub fn from_json(line: &str) -> Result<Self, NotAnEntry> {
        let object: serde_json::Map<String, serde_json::Value> = serde_json::from_str(line)
            .map_err(|error| NotAnEntry::NotJson {
                line: line.to_owned(),
                reason: error.to_string(),
            })?;
        let topic: Topic = object
            .get("topic")
            .and_then(serde_json::Value::as_str)
            .and_then(|name| name.parse().ok())
            .ok_or_else(|| NotAnEntry::NoTopic {
                line: line.to_owned(),
            })?;
        let values = topic
            .fields()
            .iter()
            .map(|field| {
                let mut names = field.split('.');
                let first = names.next().and_then(|name| object.get(name));
                value(names.fold(first, |part, name| part?.get(name)))
            })
            .collect();
        Ok(Self { topic, values })
    }
}

fn value(json: Option<&serde_json::Value>) -> Value {
    use serde_json::Value as Json;
    match json {
        None | Some(Json::Null | Json::Object(_)) => Value::Absent,
        Some(Json::Bool(value)) => Value::Bool(*value),
        Some(Json::String(text)) => Value::Text(Cow::Owned(text.clone())),
        Some(Json::Array(list)) => Value::Unsigned(list.len() as u64),
        Some(Json::Number(number)) => number
            .as_u64()
            .map(Value::Unsigned)
            .or_else(|| number.as_i64().map(Value::Signed))
            .or_else(|| number.as_f64().map(Value::Float))
            .unwrap_or(Value::Absent),
    }
}
