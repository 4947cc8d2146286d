//! Stability of the steady motion under the laws.

use numpy::{Complex64, PyArray1};
use pyo3::{prelude::*, types::PyDict};
use singletrack_analysis::stability::{self, Belief, ClosedLoop, Law, MarginLimits, SampledLoop};
use singletrack_lab::stability::Subject;

use crate::{
    argument::{choice, refuse},
    model::Vehicle,
};

/// A car in steady motion under a law.
#[derive(FromPyObject)]
pub(crate) struct Steady {
    vehicle: Vehicle,
    law: String,
    belief: String,
    point_distance: f64,
    speed: f64,
    deviation: f64,
}

impl Steady {
    fn subject(&self) -> PyResult<Subject> {
        let laws = Law::ALL.map(|law| (law.name(), law));
        let beliefs = Belief::ALL.map(|belief| (belief.name(), belief));
        Ok(Subject {
            vehicle: self.vehicle.parameters()?,
            law: choice("law", &self.law, &laws)?,
            belief: choice("belief", &self.belief, &beliefs)?,
            point_distance: self.point_distance,
        })
    }

    fn closed_loop(&self) -> PyResult<ClosedLoop> {
        let closed = self.subject()?.at(self.speed, self.deviation);
        closed.map_err(refuse)
    }
}

/// The eigenvalues of the steady motion.
#[pyfunction]
pub(crate) fn eigenvalues<'py>(
    py: Python<'py>,
    steady: Steady,
) -> PyResult<Bound<'py, PyArray1<Complex64>>> {
    let values = steady.closed_loop()?.eigenvalues();
    let values = values
        .iter()
        .map(|value| Complex64::new(value.re, value.im));
    Ok(PyArray1::from_iter(py, values))
}

/// Whether the steady motion is stable.
#[pyfunction]
pub(crate) fn is_stable(steady: Steady) -> PyResult<bool> {
    Ok(steady.closed_loop()?.is_stable())
}

/// The speed up to which the proposed law is stable.
#[pyfunction]
pub(crate) fn critical_speed(
    vehicle: Vehicle,
    point_distance: f64,
    deviations: [f64; 2],
) -> PyResult<Option<f64>> {
    stability::critical_speed(vehicle.parameters()?, point_distance, deviations).map_err(refuse)
}

/// The smallest p that is stable at every speed.
#[pyfunction]
pub(crate) fn smallest_point_distance(
    vehicle: Vehicle,
    deviations: [f64; 2],
) -> PyResult<Option<f64>> {
    stability::smallest_point_distance(vehicle.parameters()?, deviations).map_err(refuse)
}

/// The Hopf points over the deviation of the centre of mass.
#[pyfunction]
pub(crate) fn hopf_points<'py>(
    py: Python<'py>,
    steady: Steady,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let points = steady.subject()?.hopf_points(steady.speed);
    let points = points.map_err(refuse)?.into_iter();
    points
        .map(|point| {
            let row = PyDict::new(py);
            row.set_item("speed", point.speed)?;
            row.set_item("deviation", point.deviation)?;
            row.set_item("angular_frequency", point.angular_frequency)?;
            row.set_item("crossing", point.crossing)?;
            row.set_item("ends_stability", point.ends_stability())?;
            row.set_item("criticality", point.criticality().name())?;
            Ok(row)
        })
        .collect()
}

/// Spectral radius per tick of the sampled loop, and its delay margin in s.
#[pyfunction]
pub(crate) fn sampled(
    steady: Steady,
    period: f64,
    delay: f64,
    position_gain: f64,
    longest_delay: f64,
) -> PyResult<(f64, Option<f64>)> {
    let sampled = SampledLoop::new(steady.closed_loop()?, period, delay)
        .and_then(|sampled| sampled.with_position_gain(position_gain))
        .map_err(refuse)?;
    let limits = MarginLimits {
        delay: longest_delay,
        ..MarginLimits::default()
    };
    Ok((sampled.spectral_radius(), sampled.delay_margin(limits)))
}
