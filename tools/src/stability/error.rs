//! Why there is no result.

use std::io;

use singletrack_analysis::stability::{SamplingError, StabilityError};

use crate::{figure::GridError, vehicle_file::VehicleFileError};

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum StabilityCommandError {
    /// There is no such car.
    #[error(transparent)]
    Vehicle(#[from] VehicleFileError),
    /// There is no steady motion.
    #[error(transparent)]
    Stability(#[from] StabilityError),
    /// The loop can't be sampled so.
    #[error(transparent)]
    Sampling(#[from] SamplingError),
    /// There is nothing to draw a map of.
    #[error("can't draw this: {0}")]
    Grid(#[from] GridError),
    /// The result can't be written.
    #[error("can't write the result: {0}")]
    Write(#[from] io::Error),
}
