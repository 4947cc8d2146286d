//! Stability of the steady motion under the laws, and the comparison of controllers, with one that
//! is written in Python.

use numpy::{Complex64, PyArray1};
use pyo3::{
    prelude::*,
    types::{PyDict, PyTuple},
};
use pythonize::{depythonize, pythonize};
use singletrack_analysis::stability::{
    self, Belief, ClosedLoop, Law, MarginLimits, SampledLoop, Timing,
};
use singletrack_campaign::{Experiment as _, run_units, thread_count};
use singletrack_control::Reference;
use singletrack_core::{setpoint::SetpointCommand, state_stream::States};
use singletrack_lab::{
    compare::{Comparison, ControllerName, OwnPoint, csv, lines_with, markdown},
    stability::Subject,
};
use singletrack_scenario::virtual_drive::VirtualTick;

use crate::{choice, fail, model::parameters, refuse};

/// A car in steady motion under a law.
#[derive(FromPyObject)]
pub(crate) struct Steady<'py> {
    vehicle: Bound<'py, PyAny>,
    law: String,
    belief: String,
    point_distance: f64,
    speed: f64,
    deviation: f64,
}

impl Steady<'_> {
    fn subject(&self) -> PyResult<Subject> {
        let laws = Law::ALL.map(|law| (law.name(), law));
        let beliefs = Belief::ALL.map(|belief| (belief.name(), belief));
        Ok(Subject {
            vehicle: parameters(&self.vehicle)?,
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
    steady: Steady<'_>,
) -> PyResult<Bound<'py, PyArray1<Complex64>>> {
    let values = steady.closed_loop()?.eigenvalues();
    let values = values
        .iter()
        .map(|value| Complex64::new(value.re, value.im));
    Ok(PyArray1::from_iter(py, values))
}

/// Whether the steady motion is stable.
#[pyfunction]
pub(crate) fn is_stable(steady: Steady<'_>) -> PyResult<bool> {
    Ok(steady.closed_loop()?.is_stable())
}

/// The speed up to which the proposed law is stable.
#[pyfunction]
pub(crate) fn critical_speed(
    vehicle: &Bound<'_, PyAny>,
    point_distance: f64,
    deviations: [f64; 2],
) -> PyResult<Option<f64>> {
    stability::critical_speed(parameters(vehicle)?, point_distance, deviations).map_err(refuse)
}

/// The smallest p that is stable at every speed.
#[pyfunction]
pub(crate) fn smallest_point_distance(
    vehicle: &Bound<'_, PyAny>,
    deviations: [f64; 2],
) -> PyResult<Option<f64>> {
    stability::smallest_point_distance(parameters(vehicle)?, deviations).map_err(refuse)
}

/// The Hopf points over the deviation of the centre of mass.
#[pyfunction]
pub(crate) fn hopf_points<'py>(
    py: Python<'py>,
    steady: Steady<'_>,
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
    steady: Steady<'_>,
    period: f64,
    delay: f64,
    position_gain: f64,
    longest_delay: f64,
) -> PyResult<(f64, Option<f64>)> {
    let timing = Timing {
        position_gain,
        ..Timing::new(period, delay)
    };
    let sampled = SampledLoop::new(steady.closed_loop()?, timing).map_err(refuse)?;
    let limits = MarginLimits {
        delay: longest_delay,
        ..MarginLimits::default()
    };
    Ok((sampled.spectral_radius(), sampled.delay_margin(limits)))
}

/// A path of the comparison, as a reference over time.
#[pyclass(frozen, module = "singletrack._native")]
pub(crate) struct Course {
    reference: Reference,
    /// Until when a drive is counted, in s.
    #[pyo3(get)]
    until: f64,
}

#[pymethods]
impl Course {
    /// Position (m) and velocity (m/s) at a time of the drive, in s.
    fn at(&self, time: f64) -> ((f64, f64), (f64, f64)) {
        let point = self.reference.at(time);
        let position = point.position.unwrap_or_default();
        (
            (position.x, position.y),
            (point.velocity.x, point.velocity.y),
        )
    }
}

/// `begin` makes a controller of a [`Course`]: from the keys of a state to those of a set-point.
/// Returns the table as CSV and as Markdown.
#[pyfunction]
#[pyo3(signature = (begin, plan, *, name, point, threads))]
pub(crate) fn compare(
    py: Python<'_>,
    begin: &Bound<'_, PyAny>,
    plan: &Bound<'_, PyAny>,
    name: &str,
    point: &str,
    threads: Option<usize>,
) -> PyResult<(String, String)> {
    let points = [
        ("p", OwnPoint::P),
        ("front-axle", OwnPoint::FrontAxle),
        ("rear-axle", OwnPoint::RearAxle),
    ];
    let own = choice("point", point, &points)?;
    if name.is_empty() || name.contains([',', '|', '\n']) || ControllerName::named(name).is_some() {
        return Err(refuse(format!(
            "name is {name:?}: give one that no controller has, without comma, bar and line break"
        )));
    }
    let plan: Comparison = depythonize(plan).map_err(refuse)?;
    let speeds = &plan.speeds_m_s;
    if let Some(speed) = speeds.iter().find(|speed| !(0.1..=2.0).contains(*speed)) {
        return Err(refuse(format!(
            "a speed is {speed}: it lies between 0.1 and 2 m/s"
        )));
    }
    if plan.seeds == 0 {
        return Err(refuse("count is 0: give at least one seed"));
    }
    let (yours, ours): (Vec<u64>, Vec<u64>) =
        (0..plan.units()).partition(|unit| plan.is_yours(*unit));
    let mut results = Vec::new();
    for unit in yours {
        let (reference, until) = plan.path(unit).map_err(fail)?;
        let controller = begin.call1((Course { reference, until },))?;
        let mut states = States::default();
        let mut failed = None;
        let mut decide = |tick: &VirtualTick| {
            states.tick(&tick.tick);
            answer(py, &controller, &states, tick)
                .map_err(|error| failed = Some(error))
                .ok()
        };
        let result = plan.drive_yours(unit, own, &mut decide);
        if let Some(error) = failed {
            return Err(error);
        }
        results.push((unit, result.map_err(fail)?));
        // For Ctrl-C.
        py.check_signals()?;
    }
    let threads = threads.unwrap_or_else(thread_count).max(1);
    let ours = py.detach(|| run_units(&ours, threads, |unit| plan.run(unit), || {}));
    results.extend(ours.map_err(fail)?);
    results.sort_by_key(|(unit, _)| *unit);
    let lines = lines_with(&plan, &results, name);
    Ok((csv(&lines), markdown(&lines)))
}

/// What the controller answers to a tick.
fn answer(
    py: Python<'_>,
    controller: &Bound<'_, PyAny>,
    states: &States,
    tick: &VirtualTick,
) -> PyResult<SetpointCommand> {
    let state = pythonize(py, &states.state(&tick.tick))?;
    let keys = controller.call1(PyTuple::new(py, [state])?)?;
    let keys = depythonize(&keys).map_err(refuse)?;
    SetpointCommand::of(keys, tick.now).map_err(|rejected| refuse(rejected.text))
}
