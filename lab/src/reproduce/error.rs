//! Errors of a reproduction.

use std::path::PathBuf;

use singletrack_figures::output::WriteError;

use crate::vehicle_file::VehicleFileError;

/// Why a reproduction failed.
#[derive(Debug, thiserror::Error)]
pub enum ReproduceError {
    /// The car can't be used.
    #[error(transparent)]
    Vehicle(#[from] VehicleFileError),
    /// The catalogue of the claims can't be read.
    #[error("the catalogue of the claims: {0}")]
    Catalogue(#[from] toml::de::Error),
    /// A file or folder can't be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The folder holds files that this command did not write.
    #[error(
        "{} holds files that are not of an earlier reproduction ({found}); choose another folder \
         with --out",
        path.display()
    )]
    Foreign {
        /// The folder.
        path: PathBuf,
        /// The first of these files.
        found: String,
    },
    /// A claim's verdict is not the expected one.
    #[error(
        "{count} of the claims have another verdict than expected: see the lines marked with ! and {}",
        report.display()
    )]
    Surprise {
        /// The number of such claims.
        count: usize,
        /// The report.
        report: PathBuf,
    },
}
