//! Why a configuration is refused.

use core::fmt;
use std::path::{Path, PathBuf};

use singletrack_control::{LawError, ReferenceError, VehicleParameterError};
use singletrack_pilot::FenceError;
use singletrack_protocol::{ConfigurationError, ConfigurationField};
use singletrack_settings::{ValueError, explain};

use super::WaypointFileError;

/// Why a configuration is refused: key, value and fix.
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
    /// The text does not parse: a syntax error, an unknown or a missing key, a value of the
    /// wrong type.
    #[error("{}{message}", prefix(.path))]
    Parse {
        /// The file, if it came from one.
        path: Option<PathBuf>,
        /// Where and why.
        message: String,
    },
    /// The file can be read and is refused.
    #[error("{}: {source}", .path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error.
        source: Box<Self>,
    },
    /// The file of waypoints is refused.
    #[error("reference.file: {}: {source}", .path.display())]
    Waypoints {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: WaypointFileError,
    },
    /// The reference is invalid.
    #[error("reference.{0}")]
    Reference(#[from] ReferenceError),
    /// The fence is not a simple polygon.
    #[error("fence.corners_m: {0}")]
    Fence(#[from] FenceError),
    /// The law is invalid for the vehicle.
    #[error("law.{0}")]
    Law(#[from] LawError),
    /// A vehicle parameter is invalid.
    #[error("vehicle.{} is {}: it must be finite and above zero", .0.name, .0.value)]
    Vehicle(#[from] VehicleParameterError),
    /// The board refuses a value.
    #[error("{}", board_message(.0))]
    Board(#[from] ConfigurationError),
    /// A value is outside its range, or contradicts another.
    #[error(transparent)]
    Value(#[from] ValueError),
}

impl ConfigError {
    pub(crate) fn value(
        key: &'static str,
        value: impl fmt::Display,
        fix: impl Into<String>,
    ) -> Self {
        ValueError::new(key, value, fix).into()
    }

    /// The explanation why `text`, from a file or not, does not parse.
    pub(crate) fn parse(path: Option<&Path>, text: &str, error: &toml::de::Error) -> Self {
        Self::Parse {
            path: path.map(Path::to_owned),
            message: explain(text, error),
        }
    }
}

/// Top speed of the finest pulses that do not limit it.
const TOP_SPEED_MM_S: u16 = 20_000;

fn board_message(error: &ConfigurationError) -> String {
    if error.field == ConfigurationField::ServoGainMagnitude {
        return format!(
            "board.servo.gain_us_per_rad has the magnitude {}, but must have {} to {}",
            error.value, error.lowest, error.highest
        );
    }
    let coarse = match error.field {
        ConfigurationField::MaxForward | ConfigurationField::MaxReverse
            if (1..i32::from(TOP_SPEED_MM_S)).contains(&error.highest) =>
        {
            ": the board measures no more than 12 pulses of board.speed.pulse_distance_um in a \
             millisecond; use a sensor with fewer edges per turn or a lower speed"
        }
        _ => "",
    };
    format!("board.{error}{coarse}")
}

fn prefix(path: &Option<PathBuf>) -> String {
    path.as_ref()
        .map_or_else(String::new, |path| format!("{}: ", path.display()))
}
