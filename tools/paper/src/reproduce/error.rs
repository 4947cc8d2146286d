//! Why the paper was not reproduced.

use std::{
    io,
    path::{Path, PathBuf},
};

use crate::vehicle_file::VehicleFileError;

/// Why the paper was not reproduced.
#[derive(Debug, thiserror::Error)]
pub enum ReproduceError {
    /// There is no such car.
    #[error(transparent)]
    Vehicle(#[from] VehicleFileError),
    /// Something can't be written.
    #[error("can't write {}: {source}; choose another folder with --out", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The folder holds files that this command did not write.
    #[error(
        "{} holds files that are not of an earlier reproduction ({found}); choose another folder \
         with --out",
        path.display()
    )]
    Foreign {
        /// The folder.
        path: PathBuf,
        /// The first thing in it.
        found: String,
    },
    /// A claim's verdict is not the expected one.
    #[error(
        "{count} of the claims have another verdict than expected: see the lines marked with ! and {}",
        report.display()
    )]
    Surprise {
        /// How many.
        count: usize,
        /// The report.
        report: PathBuf,
    },
}

/// A file or folder that can't be written.
pub(super) fn write_error(path: &Path) -> impl FnOnce(io::Error) -> ReproduceError + use<> {
    let path = path.to_owned();
    move |source| ReproduceError::Write { path, source }
}
