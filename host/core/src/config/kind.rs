//! Sections whose `kind` says which keys they have.
//!
//! Serde reads such a section as an enumeration by itself, but its messages then lack line
//! and key. So all keys are read first, into a section of optional keys, which is converted.

use serde::Serialize;
use toml::{Table, Value};

use super::section::Declared;

/// The keys that are written, of a section `T` of optional keys.
pub(super) struct Written {
    section: &'static str,
    keys: Table,
}

impl Written {
    pub(super) fn of<T: Declared + Serialize>(section: &T) -> Result<Self, String> {
        Ok(Self {
            section: T::SECTION.name,
            keys: Table::try_from(section).map_err(|error| error.to_string())?,
        })
    }

    fn kind(&self) -> &str {
        let kind = self.keys.get("kind").and_then(Value::as_str);
        kind.unwrap_or_default()
    }

    /// A key that the kind has.
    pub(super) fn need<T>(&self, key: &str, value: Option<T>) -> Result<T, String> {
        value.ok_or_else(|| {
            let (section, kind) = (self.section, self.kind());
            format!("{section}.{key} is missing: kind = \"{kind}\" needs it")
        })
    }

    /// Refuses a key of `T` that the section as converted does not have.
    pub(super) fn only_of<T: Declared>(&self, converted: impl Serialize) -> Result<(), String> {
        let known = Table::try_from(converted).map_err(|error| error.to_string())?;
        let surplus = |key: &str| self.keys.contains_key(key) && !known.contains_key(key);
        match T::SECTION.keys.iter().find(|key| surplus(key.name)) {
            Some(key) => Err(format!(
                "{}.{} is no key of kind = \"{}\": remove it, or choose another kind",
                self.section,
                key.name,
                self.kind()
            )),
            None => Ok(()),
        }
    }
}
