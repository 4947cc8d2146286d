//! The native module of the Python package `singletrack`.
//!
//! It has no mathematics of its own: the car is that of `singletrack-sim`, the law and the
//! models are those of `singletrack-control`.

use pyo3::prelude::*;

mod environment;
mod mathematics;
mod recording;
mod setup;
mod simulator;
mod vehicle;

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<environment::Batch>()?;
    module.add_class::<simulator::Simulator>()?;
    module.add_function(wrap_pyfunction!(simulator::truth_keys, module)?)?;
    module.add_function(wrap_pyfunction!(recording::read_record, module)?)?;
    module.add_function(wrap_pyfunction!(mathematics::paper_vehicle, module)?)?;
    module.add_function(wrap_pyfunction!(mathematics::model_derivative, module)?)?;
    module.add_function(wrap_pyfunction!(mathematics::model_simulate, module)?)?;
    module.add_function(wrap_pyfunction!(mathematics::front_point, module)?)?;
    module.add_function(wrap_pyfunction!(mathematics::velocity_point, module)?)?;
    module.add_function(wrap_pyfunction!(mathematics::point_p, module)?)?;
    module.add_function(wrap_pyfunction!(mathematics::eigenvalues, module)?)?;
    module.add_function(wrap_pyfunction!(mathematics::is_stable, module)?)?;
    module.add_function(wrap_pyfunction!(mathematics::critical_speed, module)?)?;
    module.add_function(wrap_pyfunction!(
        mathematics::smallest_point_distance,
        module
    )?)?;
    module.add_function(wrap_pyfunction!(mathematics::hopf_points, module)?)?;
    module.add_function(wrap_pyfunction!(mathematics::sampled, module)?)?;
    Ok(())
}
