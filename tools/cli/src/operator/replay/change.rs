//! `--set key=value`: a change of a recorded configuration.

use std::{fmt, str::FromStr};

use toml::{Table, Value};

/// A key of the configuration, and what it is to be.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    key: Vec<String>,
    value: Value,
}

impl FromStr for Change {
    type Err = String;

    /// A value is written as in the configuration; words need no quotation marks.
    fn from_str(text: &str) -> Result<Self, String> {
        let (key, value) = text.split_once('=').ok_or_else(|| {
            format!("{text:?}: write KEY=VALUE, such as law.point_distance_m=0.4")
        })?;
        let key: Vec<_> = key.split('.').map(|part| part.trim().to_owned()).collect();
        if key.iter().any(String::is_empty) {
            let key = key.join(".");
            return Err(format!(
                "{key:?} is no key: write it as law.point_distance_m"
            ));
        }
        let value = value.trim();
        Ok(Self {
            key,
            value: value
                .parse()
                .unwrap_or_else(|_| Value::String(value.to_owned())),
        })
    }
}

impl fmt::Display for Change {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}={}", self.key.join("."), self.value)
    }
}

/// The configuration `toml` with changes.
pub(super) fn apply(toml: &str, changes: &[Change]) -> Result<String, String> {
    let of_record = |error: &dyn fmt::Display| format!("the configuration in the record: {error}");
    let mut table: Table = toml::from_str(toml).map_err(|error| of_record(&error))?;
    for change in changes {
        let Some((last, sections)) = change.key.split_last() else {
            continue;
        };
        let mut place = &mut table;
        for section in sections {
            let inner = place
                .entry(section.clone())
                .or_insert_with(|| Value::Table(Table::new()));
            place = match inner {
                Value::Table(table) => table,
                other => {
                    let key = change.key.join(".");
                    return Err(format!("{key}: {section} is no section but {other}"));
                }
            };
        }
        let value = match (place.get(last), &change.value) {
            // As people write it: 1 for 1.0.
            (Some(Value::Float(_)), Value::Integer(number)) => Value::Float(*number as f64),
            (_, value) => value.clone(),
        };
        place.insert(last.clone(), value);
    }
    toml::to_string(&table).map_err(|error| of_record(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOML: &str = "[law]\npoint_distance_m = 0.35\n[estimator]\nmarker_loss = \"hold\"\n";

    fn changed(changes: &[&str]) -> Result<String, String> {
        let changes: Result<Vec<Change>, _> = changes.iter().map(|text| text.parse()).collect();
        apply(TOML, &changes?)
    }

    #[test]
    fn numbers_and_words_are_set_and_keys_added() {
        let text = changed(&[
            "law.point_distance_m=1",
            "estimator.marker_loss = coast",
            "supervisor.hold_ms=500",
            "fence.corners_m=[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]",
        ])
        .unwrap();
        let table: Table = toml::from_str(&text).unwrap();
        assert_eq!(table["law"]["point_distance_m"], Value::Float(1.0));
        assert_eq!(table["estimator"]["marker_loss"].as_str(), Some("coast"));
        assert_eq!(table["supervisor"]["hold_ms"].as_integer(), Some(500));
        assert_eq!(table["fence"]["corners_m"].as_array().unwrap().len(), 3);
    }

    #[test]
    fn what_is_no_change_is_refused_by_name() {
        for (text, part) in [
            ("law.point_distance_m", "KEY=VALUE"),
            ("law..x=1", "law..x"),
            ("=1", "no key"),
            ("law.point_distance_m.x=1", "no section but 0.35"),
        ] {
            let error = changed(&[text]).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}
