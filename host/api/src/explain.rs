//! What is wrong with a line of JSON, in the words of its author: which key, what it was given,
//! and what it takes. Serde alone speaks of variants, fields and `f64`.

use serde::de::DeserializeOwned;
use serde_json::{Map, Value, error::Category};
use singletrack_settings::{expected, kind, list, quoted_after, shortened};

/// Why the keys are no `T`, or `None` if they are.
///
/// `tags` are the keys that say which others there are, such as `kind`. `within` precedes the names
/// of the keys.
pub fn explain<T: DeserializeOwned>(
    keys: &Map<String, Value>,
    tags: &[&str],
    within: &str,
) -> Option<String> {
    let error = |keys: Map<String, Value>| {
        let read = serde_json::from_value::<T>(keys.into());
        read.err().map(|error| error.to_string())
    };
    let message = error(keys.clone())?;
    if let Some(field) = quoted_after(&message, "missing field ") {
        return Some(format!("{within}{field} is missing"));
    }
    if let Some(field) = quoted_after(&message, "unknown field ") {
        let others = known(&message, "");
        return Some(match (others.is_empty(), keys.contains_key(field)) {
            (true, _) => format!("unknown key {within}{field}: remove it"),
            (false, true) => format!("unknown key {within}{field}: use {others}"),
            (false, false) => format!("unknown key {field} in a list: use {others}"),
        });
    }
    let of_a_tag = |key: &str| {
        let value = keys.get(key).and_then(Value::as_str)?;
        let unknown = quoted_after(&message, "unknown variant ")?;
        (unknown == value).then(|| key.to_owned())
    };
    // A wrong value is wrong also without the other keys.
    let alone = |key: &&String| {
        let given = keys
            .iter()
            .filter(|(other, _)| other == key || tags.contains(&other.as_str()))
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect();
        error(given).as_deref() == Some(&message)
    };
    let others = || keys.keys().filter(|key| !tags.contains(&key.as_str()));
    let key = tags.iter().find_map(|key| of_a_tag(key));
    let key = key.or_else(|| others().find(alone).cloned());
    let (Some(key), Some(what)) = (key, in_plain_words(&message)) else {
        // A message of ours, which names the key.
        return Some(message);
    };
    let value = keys.get(&key).unwrap_or(&Value::Null);
    let what = match what.strip_prefix("it takes ") {
        Some(one) if value.is_array() && !one.starts_with("two ") => {
            format!("a value in it must be {one}")
        }
        _ => what,
    };
    Some(format!("{within}{key} is {}: {what}", quote(value)))
}

/// Whether a text is no JSON for a number that no `f64` holds. Serde has no other sign of it.
pub fn is_too_large(error: &serde_json::Error) -> bool {
    error.to_string().starts_with("number out of range")
}

/// Why a text is no object of JSON.
pub(crate) fn no_object(text: &[u8], error: &serde_json::Error) -> String {
    let column = error.column();
    match error.classify() {
        _ if is_too_large(error) => {
            format!("the number that ends at character {column} is too large")
        }
        Category::Eof => "the line is not JSON: it ends too early".to_owned(),
        Category::Data => "the line is not an object of JSON, such as {\"key\":1}".to_owned(),
        Category::Syntax | Category::Io => {
            let rest = text.get(column.saturating_sub(1)..).unwrap_or_default();
            let rest = String::from_utf8_lossy(rest);
            let rest = rest.trim_end();
            let word = rest.split([',', ':', ']', '}']).next().unwrap_or_default();
            let word = if word.is_empty() { rest } else { word };
            let word = shortened(word);
            format!("the line is not JSON at character {column}: {word}")
        }
    }
}

/// The key that a line has twice.
pub(crate) fn duplicate(message: &str) -> Option<String> {
    let key = quoted_after(message, "duplicate field ")?;
    Some(format!("{key} is given twice: keep one"))
}

/// What to write instead; `None` for a message of ours.
fn in_plain_words(message: &str) -> Option<String> {
    if message.starts_with("unknown variant ") {
        return Some(format!("use {}", known(message, "\"")));
    }
    let (_, expected) = message.rsplit_once(", expected ")?;
    let value = match expected {
        "a sequence" => "a list in brackets",
        "an array of length 2" => "two numbers, such as [0.4,0.0]",
        other if other.starts_with("struct ") => "an object in braces",
        other => kind(other)?,
    };
    Some(format!("it takes {value}"))
}

fn known(message: &str, quote: &str) -> String {
    list(expected(message), quote)
}

fn quote(value: &Value) -> String {
    shortened(&value.to_string())
}
