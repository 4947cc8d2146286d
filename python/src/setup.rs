//! Arguments from Python, and the errors that name them.

use std::time::Duration;

use pyo3::{
    PyErr, PyResult,
    exceptions::{PyRuntimeError, PyValueError},
};
use singletrack_scenario::laboratory;

/// An argument is wrong.
pub(crate) fn refuse(error: impl ToString) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// A call can't be obeyed now.
pub(crate) fn fail(error: impl ToString) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

/// A time in s, which may not be negative.
pub(crate) fn seconds(time: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(time).map_err(refuse)
}

/// The value of a word; another word is refused with those that are known.
pub(crate) fn choice<T: Copy>(name: &str, word: &str, known: &[(&str, T)]) -> PyResult<T> {
    laboratory::choice(name, word, known).map_err(refuse)
}
