//! Why a stability study failed.

use std::io;

use singletrack_analysis::stability::{SamplingError, StabilityError};
use singletrack_figures::figure::GridError;

use crate::vehicle_file::VehicleFileError;

/// Why a stability study failed.
#[derive(Debug, thiserror::Error)]
pub enum StabilityCommandError {
    /// The vehicle file is invalid.
    #[error(transparent)]
    Vehicle(#[from] VehicleFileError),
    /// There is no steady motion.
    #[error(transparent)]
    Stability(#[from] StabilityError),
    /// The timing is invalid.
    #[error(transparent)]
    Sampling(#[from] SamplingError),
    /// There is nothing to draw a map of.
    #[error("can't draw this: {0}")]
    Grid(#[from] GridError),
    /// The result can't be written.
    #[error("can't write the result: {0}")]
    Write(#[from] io::Error),
}
