//! Sections of the daemon's configuration of which only some keys are written.

use serde::{Serialize, de::DeserializeOwned};
use singletrack_settings::explain_table;
use toml::{Table, Value};

use super::error::ScenarioError;

/// Replaces the keys of a section that are written, at any depth. An unknown key is an
/// error.
pub(super) fn layer<T: Serialize + DeserializeOwned>(
    section: &'static str,
    base: &mut T,
    written: Option<&Table>,
) -> Result<(), ScenarioError> {
    let Some(written) = written.filter(|written| !written.is_empty()) else {
        return Ok(());
    };
    let error = |message: String| ScenarioError::Layer {
        section,
        message: message.trim_end().to_owned(),
    };
    let mut table = Table::try_from(&*base).map_err(|cause| error(cause.to_string()))?;
    merge(&mut table, written);
    *base = table
        .try_into()
        .map_err(|cause| error(explain_table(&cause)))?;
    Ok(())
}

/// Replaces the keys that are written, at any depth.
pub fn merge(base: &mut Table, written: &Table) {
    for (key, value) in written {
        match (base.get_mut(key), value) {
            (Some(Value::Table(base)), Value::Table(written)) => merge(base, written),
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}
