//! Why a map is not accepted.

use std::{io, path::PathBuf};

/// A map that can't be used.
#[derive(Debug, thiserror::Error)]
pub enum MapError {
    /// The file can't be read.
    #[error("can't read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is not a map.
    #[error("{}: {message}", path.display())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Where and why.
        message: String,
    },
    /// The map has no column for the speed of the motor.
    #[error("{} has no section [motor]: add it with the column of the speed of motor or wheels, which the estimator needs; a log without one can't be imported", .0.display())]
    NoMotor(PathBuf),
    /// A value is invalid.
    #[error("{}: {key} is {value}: {fix}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The key.
        key: &'static str,
        /// Its value.
        value: String,
        /// The rule that it breaks.
        fix: String,
    },
}
