//! Why plotting failed.

use std::path::PathBuf;

use singletrack_record::RecordError;

use crate::output::WriteError;

/// Why plotting failed.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// The record can't be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The car never drove.
    #[error("{}: there is no drive in this record: {why}; singletrack dump --topic tick shows what there is", path.display())]
    NoDrive {
        /// The record.
        path: PathBuf,
        /// What there is instead.
        why: String,
    },
    /// The record has fewer drives.
    #[error("{}: there is no drive {wanted}: choose --drive from 1 to {count}", path.display())]
    UnknownDrive {
        /// The record.
        path: PathBuf,
        /// The number asked for.
        wanted: usize,
        /// How many there are.
        count: usize,
    },
    /// The drive can't be shown from above.
    #[error("{}: no animation: {why}", path.display())]
    NoAnimation {
        /// The record.
        path: PathBuf,
        /// What it lacks.
        why: &'static str,
    },
    /// A picture can't be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}
