//! Why a scenario is refused, and how one file is laid over another.

use std::path::PathBuf;

use serde::{Serialize, de::DeserializeOwned};
use singletrack_control::LawError;
use singletrack_core::config::{ConfigError, TuningError};
use singletrack_settings::{ValueError, explain_table};
use toml::{Table, Value};

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

/// A scenario that can't be simulated.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file can't be read.
    #[error("can't read {}: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not a scenario.
    #[error("{}: {message}", .path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        message: String,
    },
    /// A section of the daemon's configuration is invalid.
    #[error(transparent)]
    Section(#[from] ConfigError),
    /// The law is invalid.
    #[error("[law] {0}")]
    Law(#[from] LawError),
    /// The vehicle is invalid.
    #[error("[vehicle] {0}")]
    Vehicle(#[from] singletrack_control::VehicleParameterError),
    /// A section of the daemon's configuration can't be read.
    #[error("[{section}] {message}")]
    Layer {
        /// The section.
        section: &'static str,
        /// Why.
        message: String,
    },
    /// The truth of the car can't be simulated.
    #[error(transparent)]
    Truth(#[from] singletrack_sim::ConfigError),
    /// A tuning that the daemon refuses.
    #[error("[[tune]] at_s = {at_s}: {source}")]
    Tune {
        /// When, s.
        at_s: f64,
        /// Why.
        source: TuningError,
    },
    /// A value is outside its range.
    #[error(transparent)]
    Value(#[from] ValueError),
}

impl ScenarioError {
    pub(super) fn value(
        key: &'static str,
        value: impl std::fmt::Display,
        fix: &'static str,
    ) -> Self {
        ValueError::new(key, value, fix).into()
    }
}
