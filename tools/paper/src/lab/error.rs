//! Why a lab can't be shown or marked.

use std::{io, path::PathBuf};

use singletrack_analysis::stability::{SamplingError, StabilityError};
use singletrack_scenario::simulate::{ScenarioError, SimulateError};

use super::LABS;

/// Why a lab can't be shown or marked.
#[derive(Debug, thiserror::Error)]
pub enum LabError {
    /// The file of answers can't be read.
    #[error(
        "can't read {path}: {source}; `singletrack lab show LAB --student NAME` writes such a file"
    )]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file for the answers can't be written.
    #[error("can't write {path}: {source}; choose another file with --out")]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Standard output is closed.
    #[error("can't print: {0}")]
    Print(#[source] io::Error),
    /// The marks can't be written as JSON.
    #[error("can't print: {0}")]
    Json(#[from] serde_json::Error),
    /// The file is no file of answers.
    #[error("{path}: {source}")]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: Box<LabError>,
    },
    /// The file is not TOML, or has other keys.
    #[error("{0}; a file of answers has `lab`, `student` and a table [answers]")]
    Parse(#[from] toml::de::Error),
    /// There is no lab of this number.
    #[error("lab = {0}: there are the labs 1 to {LABS}")]
    NoSuchLab(i64),
    /// The student has no name.
    #[error("student = {0:?}: write the name with at least one letter or digit")]
    NoName(String),
    /// An answer to a question that the lab does not have.
    #[error("answers.{key} is no answer of lab {lab}; its answers are {known}")]
    UnknownAnswer {
        /// The key.
        key: String,
        /// The lab.
        lab: u8,
        /// The keys of the lab.
        known: String,
    },
    /// An answer is not a number.
    #[error(
        "answers.{key} = {value}: write a number in {unit} without quotes, or \"?\" for no answer"
    )]
    NotANumber {
        /// The key.
        key: String,
        /// What stands there.
        value: String,
        /// The unit of the answer.
        unit: &'static str,
    },
    /// A scenario of an exercise is refused.
    #[error("the exercise can't be simulated: {0}")]
    Scenario(#[from] ScenarioError),
    /// A simulation ended early.
    #[error("the exercise can't be simulated: {0}")]
    Simulate(#[from] SimulateError),
    /// The analysis refuses parameters.
    #[error("the exercise can't be computed: {0}")]
    Stability(#[from] StabilityError),
    /// The sampled loop refuses parameters.
    #[error("the exercise can't be computed: {0}")]
    Sampling(#[from] SamplingError),
    /// A search for a limit found none.
    #[error("the exercise can't be computed: no {0} was found")]
    NotFound(&'static str),
}

impl LabError {
    /// This error, in a file.
    pub(super) fn of(self, path: &std::path::Path) -> Self {
        Self::File {
            path: path.to_owned(),
            source: Box::new(self),
        }
    }
}
