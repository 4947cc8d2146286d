//! Sections whose `kind` says which keys they have.
//!
//! Serde reads such a section as an enumeration by itself, but its messages then lack line
//! and key. So all keys are read first, into a section of optional keys, which is converted.

use serde::{Serialize, de::DeserializeOwned};
use toml::{Table, Value};

use crate::{Declared, ValueError};

/// The keys that are written, of a section `T` of optional keys.
#[derive(Debug)]
pub struct Written {
    section: &'static str,
    keys: Table,
}

impl Written {
    /// The keys of this section.
    ///
    /// # Errors
    ///
    /// A path is not UTF-8.
    pub fn of<T: Declared + Serialize>(section: &T) -> Result<Self, String> {
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
    ///
    /// # Errors
    ///
    /// It is missing.
    pub fn need<T>(&self, key: &str, value: Option<T>) -> Result<T, String> {
        value.ok_or_else(|| {
            let (section, kind) = (self.section, self.kind());
            format!("{section}.{key} is missing: kind = \"{kind}\" needs it")
        })
    }

    /// The settings of a kind, whose keys are those of `T`, of all those of `Keys`.
    ///
    /// # Errors
    ///
    /// The first other key.
    pub fn settings<Keys, T>(mut self) -> Result<T, String>
    where
        Keys: Declared,
        T: Default + Serialize + DeserializeOwned,
    {
        self.only_of::<Keys>(T::default())?;
        self.keys.remove("kind");
        self.keys.try_into().map_err(|error| error.to_string())
    }

    /// Refuses a key of `T` that the section as converted does not have.
    ///
    /// # Errors
    ///
    /// The first such key.
    pub fn only_of<T: Declared>(&self, converted: impl Serialize) -> Result<(), String> {
        let known = Table::try_from(converted).map_err(|error| error.to_string())?;
        let surplus =
            |key: &str| key != "kind" && self.keys.contains_key(key) && !known.contains_key(key);
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

/// Refuses values outside their ranges in `T`, from which the section was converted.
///
/// # Errors
///
/// The first such value.
pub fn check_kind<T: Declared + DeserializeOwned>(
    converted: impl Serialize,
) -> Result<(), ValueError> {
    match Value::try_from(converted).map(Value::try_into::<T>) {
        Ok(Ok(keys)) => keys.check(),
        // A path that is not UTF-8: all else was read from such a value.
        _ => Ok(()),
    }
}
