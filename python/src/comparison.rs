//! The comparison of controllers, with one that is written in Python.

use pyo3::{prelude::*, types::PyTuple};
use pythonize::{depythonize, pythonize};
use singletrack_campaign::{Experiment as _, run_units, thread_count};
use singletrack_control::Reference;
use singletrack_core::{setpoint::SetpointCommand, state_stream::States};
use singletrack_lab::compare::{
    Comparison, Condition, ControllerName, OwnPoint, PathName, csv, lines_with, markdown,
};
use singletrack_scenario::virtual_drive::VirtualTick;

use crate::argument::{choice, fail, refuse};

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
        controllers: rows,
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
