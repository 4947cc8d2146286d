//! What can be wrong with a configuration.

use core::fmt;
use std::path::{Path, PathBuf};

use singletrack_control::{LawError, ReferenceError, VehicleParameterError};
use singletrack_pilot::FenceError;
use singletrack_protocol::{ConfigurationError, ConfigurationField};

use super::{WaypointFileError, explain::explain};

/// A configuration with which nothing can be driven: key, value and fix.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file can't be read.
    #[error("can't read {}: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is no configuration: a syntax error, an unknown or a missing
    /// key, a value of the wrong type.
    #[error("{}{message}", prefix(.path))]
    Parse {
        /// The file, if it came from one.
        path: Option<PathBuf>,
        /// Where and why.
        message: String,
    },
    /// What is wrong with a file that could be read.
    #[error("{}: {source}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error.
        source: Box<Self>,
    },
    /// The waypoints can't be read.
    #[error("reference.file: {}: {source}", .path.display())]
    Waypoints {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: WaypointFileError,
    },
    /// The reference makes no sense.
    #[error("reference.{0}")]
    Reference(#[from] ReferenceError),
    /// The fence encloses nothing.
    #[error("fence.corners_m: {0}")]
    Fence(#[from] FenceError),
    /// The law makes no sense.
    #[error("law.{0}")]
    Law(#[from] LawError),
    /// The vehicle makes no sense.
    #[error("vehicle.{} is {}: it must be finite and above zero", .0.name, .0.value)]
    Vehicle(#[from] VehicleParameterError),
    /// No board would take these values.
    #[error("{}", board_message(.0))]
    Board(#[from] ConfigurationError),
    /// A value outside its range, or at odds with another.
    #[error("{key} is {value}: {fix}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        value: String,
        /// What it may be.
        fix: String,
    },
}

impl ConfigError {
    pub(crate) fn value(
        key: &'static str,
        value: impl fmt::Display,
        fix: impl Into<String>,
    ) -> Self {
        Self::Value {
            key,
            value: value.to_string(),
            fix: fix.into(),
        }
    }

    /// Why `text`, from a file or not, is no configuration.
    pub(crate) fn parse(path: Option<&Path>, text: &str, error: &toml::de::Error) -> Self {
        Self::Parse {
            path: path.map(Path::to_owned),
            message: explain(text, error),
        }
    }
}

fn board_message(error: &ConfigurationError) -> String {
    if error.field == ConfigurationField::ServoGainMagnitude {
        return format!(
            "board.servo.gain_us_per_rad has the magnitude {}, but must have {} to {}",
            error.value, error.lowest, error.highest
        );
    }
    format!("board.{error}")
}

fn prefix(path: &Option<PathBuf>) -> String {
    path.as_ref()
        .map_or_else(String::new, |path| format!("{}: ", path.display()))
}
