//! Why a scenario can't be simulated.

use std::path::PathBuf;

use singletrack_control::LawError;
use singletrack_core::config::{ConfigError, TuningError};
use singletrack_settings::ValueError;

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
