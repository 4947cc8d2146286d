//! Entries as lines of JSON, which the daemon sends to its watchers.

use std::borrow::Cow;

use crate::{Entry, Topic, Value, value::Json as Writer};

/// Adds one object to `json`, without a line end: the topic, then the fields by their
/// paths, such as `{"topic":"tick","estimate.yaw_rad":0.3}`.
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

/// The part of an entry that a table shows, from a line of JSON.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// The kind of entry.
    pub topic: Topic,
    /// Its fields, in the order of [`Topic::fields`], as from [`Entry::values`].
    pub values: Vec<Value>,
}

/// A line of JSON is not an entry.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ParseEntryError {
    /// The line is not a JSON object.
    #[error("not a JSON object ({reason}): {line}")]
    NotJson {
        /// The line.
        line: String,
        /// The reason.
        reason: String,
    },
    /// The topic is missing or unknown.
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
    /// Reads a line that [`Entry::write_json`] wrote. A missing field is absent, because
    /// the writer may be another release.
    ///
    /// # Errors
    ///
    /// When the line is not a JSON object or its topic is unknown.
    pub fn from_json(line: &str) -> Result<Self, ParseEntryError> {
        let object: serde_json::Map<String, serde_json::Value> = serde_json::from_str(line)
            .map_err(|error| ParseEntryError::NotJson {
                line: line.to_owned(),
                reason: error.to_string(),
            })?;
        let topic: Topic = object
            .get("topic")
            .and_then(serde_json::Value::as_str)
            .and_then(|name| name.parse().ok())
            .ok_or_else(|| ParseEntryError::NoTopic {
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
