//! The native module of the Python package `singletrack`.
//!
//! It has no mathematics of its own: the car is that of `singletrack-sim`, the law and the
//! models are those of `singletrack-control`.

#![allow(
    clippy::needless_pass_by_value,
    reason = "Python's arguments are converted to values of our own"
)]

mod cameras;
mod environment;
mod model;
mod recording;
mod simulator;
mod socket;
mod stability;
mod vehicle;

use std::time::Duration;

use pyo3::{
    exceptions::{PyRuntimeError, PyValueError},
    prelude::*,
};
use singletrack_scenario::laboratory;

#[pymodule]
mod _native {
    #[pymodule_export]
    use crate::{
        cameras::{CameraSession, PoseWriter, camera_questions},
        environment::Batch,
        model::{
            front_point, model_derivative, model_simulate, paper_vehicle, point_p, velocity_point,
        },
        recording::read_record,
        simulator::{Simulator, truth_keys},
        socket::{Connection, Fleet, FleetDrive},
        stability::{
            Course, compare, critical_speed, eigenvalues, hopf_points, is_stable, sampled,
            smallest_point_distance,
        },
    };
}

/// An argument is wrong.
fn refuse(error: impl ToString) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// A call can't be obeyed now.
fn fail(error: impl ToString) -> PyErr {
    PyRuntimeError::new_err(error.to_string())
}

/// A time in s, which may not be negative.
fn seconds(time: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(time).map_err(refuse)
}

/// The value of a word; another word is refused with those that are known.
fn choice<T: Copy>(name: &str, word: &str, known: &[(&str, T)]) -> PyResult<T> {
    laboratory::choice(name, word, known).map_err(refuse)
}
