//! Why a log can't be imported.

use std::{
    error::Error,
    path::{Path, PathBuf},
};

use singletrack_record::RecordError;

/// Why a log was not imported.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A file can't be read.
    #[error("can't read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: Box<dyn Error + Send + Sync>,
    },
    /// The map or the log is invalid: where, why, and what to do.
    #[error("{0}")]
    Invalid(String),
    /// The record.
    #[error(transparent)]
    Record(#[from] RecordError),
}

impl ImportError {
    /// The error of a reader about this file.
    pub(super) fn read<E: Error + Send + Sync + 'static>(path: &Path) -> impl Fn(E) -> Self + Copy {
        |source| Self::Read {
            path: path.to_owned(),
            source: source.into(),
        }
    }

    /// What is invalid in this file.
    pub(super) fn file(path: &Path, why: impl AsRef<str>) -> Self {
        Self::Invalid(path.display().to_string() + why.as_ref())
    }
}
