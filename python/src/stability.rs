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
    compare::{
        Comparison, Condition, ControllerName, OwnPoint, PathName, csv, lines_with, markdown,
    },
    stability::Subject,
};
use singletrack_scenario::virtual_drive::VirtualTick;

use crate::{
    model::Vehicle,
    setup::{choice, fail, refuse},
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
#[pyo3(signature = (
    begin, *, name, point, controllers, paths, speeds, conditions, first_seed, count, threads
))]
#[expect(clippy::too_many_arguments, reason = "Python gives them by name")]
pub(crate) fn compare(
    py: Python<'_>,
    begin: &Bound<'_, PyAny>,
    name: &str,
    point: &str,
    controllers: Vec<String>,
    paths: Vec<String>,
    speeds: Vec<f64>,
    conditions: Vec<String>,
    first_seed: u64,
    count: u64,
    threads: Option<usize>,
) -> PyResult<(String, String)> {
    let own = choice(
        "point",
        point,
        &[
            ("p", OwnPoint::P),
            ("front-axle", OwnPoint::FrontAxle),
            ("rear-axle", OwnPoint::RearAxle),
        ],
    )?;
    if name.is_empty() || name.contains([',', '|', '\n']) || ControllerName::named(name).is_some() {
        return Err(refuse(format!(
            "name is {name:?}: give one that no controller has, without comma, bar and line break"
        )));
    }
    if let Some(speed) = speeds.iter().find(|speed| !(0.1..=2.0).contains(*speed)) {
        return Err(refuse(format!(
            "a speed is {speed}: it lies between 0.1 and 2 m/s"
        )));
    }
    if count == 0 {
        return Err(refuse("count is 0: give at least one seed"));
    }
    let all = |controller: ControllerName| (controller.name(), controller);
    let known: Vec<_> = ControllerName::ALL
        .into_iter()
        .filter(|controller| *controller != ControllerName::Yours)
        .map(all)
        .collect();
    let mut rows = vec![ControllerName::Yours];
    for word in &controllers {
        rows.push(choice("a controller", word, &known)?);
    }
    let plan = Comparison {
        controllers: rows.into_iter().map(Into::into).collect(),
        paths: words(
            "a path",
            &paths,
            &PathName::ALL.map(|path| (path.name(), path)),
        )?,
        speeds_m_s: speeds,
        conditions: words(
            "a condition",
            &conditions,
            &Condition::ALL.map(|condition| (condition.name(), condition)),
        )?,
        first_seed,
        seeds: count,
        delay_seeds: count,
    };
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

fn words<T: Copy>(name: &str, given: &[String], known: &[(&str, T)]) -> PyResult<Vec<T>> {
    given.iter().map(|word| choice(name, word, known)).collect()
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
