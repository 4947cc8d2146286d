//! The native module of the Python package `singletrack`.
//!
//! It has no mathematics of its own: the car is that of `singletrack-sim`, the law and the
//! models are those of `singletrack-control`.

#![allow(
    clippy::needless_pass_by_value,
    reason = "Python's arguments are converted to values of our own"
)]

use pyo3::prelude::*;

mod cameras;
mod environment;
mod model;
mod recording;
mod setup;
mod simulator;
mod socket;
mod stability;
mod vehicle;

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
