//! The whole system in virtual time: the native half of `singletrack.Simulator`.

use std::{
    path::PathBuf,
    sync::{Mutex, MutexGuard},
};

use pyo3::{
    exceptions::{PyOSError, PyValueError},
    prelude::*,
    types::{IntoPyDict as _, PyDict},
};
use pythonize::{depythonize, pythonize};
use singletrack_control::Velocity;
use singletrack_core::config::ReferenceSection;
use singletrack_pilot::Tuning;
use singletrack_scenario::laboratory::{FaultValue, Laboratory, Setup, reference};
use singletrack_sim::{StartPose, TRUTH_KEYS};

use crate::{fail, refuse};

/// Ticks after which a signal of the program is seen.
const TICKS_PER_CHECK: usize = 1_000;

/// A host, a board, cameras and a car in virtual time.
#[pyclass(frozen, module = "singletrack._native")]
pub(crate) struct Simulator(Mutex<Laboratory>);

#[pymethods]
impl Simulator {
    #[new]
    #[pyo3(signature = (*, seed, start, point, configuration, truth, reference_toml, record))]
    fn new(
        seed: u64,
        start: [f64; 3],
        point: bool,
        configuration: &str,
        truth: &str,
        reference_toml: Option<&str>,
        record: Option<PathBuf>,
    ) -> PyResult<Self> {
        let section = match reference_toml {
            Some(text) => reference(text).map_err(refuse)?,
            None => ReferenceSection::External {
                setpoint_timeout_ms: 200,
            },
        };
        let setup = Setup::new(section, configuration, truth).map_err(refuse)?;
        let [x_m, y_m, yaw_rad] = start;
        let start = if point {
            setup.start([x_m, y_m], yaw_rad)
        } else {
            StartPose { x_m, y_m, yaw_rad }
        };
        let simulation = setup.simulation(seed, start, &[]).map_err(refuse)?;
        let mut laboratory = Laboratory::new(setup.config, seed, simulation).map_err(refuse)?;
        if let Some(path) = record {
            let started = laboratory.record(Some(&path));
            started.map_err(|error| PyOSError::new_err(error.to_string()))?;
        }
        Ok(Self(Mutex::new(laboratory)))
    }

    /// Runs ticks of 10 ms.
    #[pyo3(signature = (count = 1))]
    fn step(&self, py: Python<'_>, count: u32) -> PyResult<()> {
        for begun in (0..count).step_by(TICKS_PER_CHECK) {
            py.detach(|| {
                let mut laboratory = self.laboratory()?;
                let ticks = (count - begun).min(TICKS_PER_CHECK as u32);
                (0..ticks).try_for_each(|_| laboratory.step().map(drop).map_err(fail))
            })?;
            // For Ctrl-C.
            py.check_signals()?;
        }
        Ok(())
    }

    /// What the last tick saw and did; `None` before the first.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let state = self.laboratory()?.state();
        Ok(state.map(|state| pythonize(py, &state)).transpose()?)
    }

    /// The mode after the last tick.
    #[getter]
    fn mode(&self) -> PyResult<&'static str> {
        Ok(self.laboratory()?.drive.mode().name())
    }

    /// The present, in s of virtual time.
    #[getter]
    fn now(&self) -> PyResult<f64> {
        Ok(self.laboratory()?.now().0 as f64 * 1e-9)
    }

    /// Requests something of the pilot, with the next tick.
    fn request(&self, request: &str) -> PyResult<()> {
        let request = self.laboratory()?.request(request);
        request.map_err(refuse)?.map_err(fail)
    }

    /// Puts another reference in force.
    fn set_reference(&self, py: Python<'_>, toml: &str) -> PyResult<u32> {
        let section = reference(toml).map_err(refuse)?;
        py.detach(|| self.laboratory()?.set_reference(section).map_err(refuse))
    }

    /// Tunes the pilot, with the next tick.
    #[pyo3(signature = (*, gain_per_s = None, point_distance_m = None))]
    fn tune(&self, gain_per_s: Option<[f64; 2]>, point_distance_m: Option<f64>) -> PyResult<()> {
        let tuning = Tuning {
            gain: gain_per_s.map(Velocity::from),
            point_distance: point_distance_m,
        };
        self.laboratory()?.drive.host().tune(tuning).map_err(refuse)
    }

    /// Whether the reference is that of a controller outside.
    #[getter]
    fn is_external(&self) -> PyResult<bool> {
        Ok(self.laboratory()?.is_external())
    }

    /// Gives a set-point by the keys of the control socket, decided after the last tick. One that is
    /// not obeyed is refused with the reason and the daemon's word for it.
    fn setpoint(&self, keys: &Bound<'_, PyAny>) -> PyResult<()> {
        let laboratory = self.laboratory()?;
        let given = laboratory.setpoint(depythonize(keys).map_err(refuse)?);
        given.map_err(|rejected| match laboratory.last() {
            Some(_) => PyValueError::new_err((rejected.text, rejected.code.name())),
            None => fail(rejected.text),
        })
    }

    /// The ground truth.
    fn truth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let laboratory = self.laboratory()?;
        let truth = laboratory.drive.world.truth();
        let dictionary = [
            ("t", truth.time_us as f64 * 1e-6),
            ("x", truth.x),
            ("y", truth.y),
            ("yaw", truth.yaw),
            ("speed", truth.speed),
            ("sideslip", truth.sideslip),
            ("yaw_rate", truth.yaw_rate),
            ("steering", truth.steering),
            ("wheel_speed", truth.wheel_speed),
            ("battery_v", truth.battery_v),
            ("way", truth.way),
        ]
        .into_py_dict(py)?;
        let [x, y] = laboratory.true_point();
        dictionary.set_item("point", (x, y))?;
        Ok(dictionary)
    }

    /// Loses the markers periodically, such as `200ms@2s` from now on; never with `None`.
    #[pyo3(signature = (pattern))]
    fn marker_loss(&self, pattern: Option<&str>) -> PyResult<()> {
        self.laboratory()?.marker_loss(pattern).map_err(refuse)
    }

    /// Loses the markers once, from now on, for a duration such as `300ms`.
    fn lose_markers(&self, duration: &str) -> PyResult<()> {
        self.laboratory()?.lose_markers(duration).map_err(refuse)
    }

    /// Sets a fault by its name; `value` is a word or a number.
    fn set_fault(&self, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let value: FaultValue = depythonize(value).map_err(refuse)?;
        self.laboratory()?.set_fault(name, &value).map_err(refuse)
    }

    /// Presses the board's reset button.
    fn press_reset(&self) -> PyResult<()> {
        self.laboratory()?.drive.world.press_reset();
        Ok(())
    }

    /// Puts the car down elsewhere, at rest.
    fn place(&self, x_m: f64, y_m: f64, yaw_rad: f64) -> PyResult<()> {
        let pose = StartPose { x_m, y_m, yaw_rad };
        self.laboratory()?.place(pose).map_err(refuse)
    }

    /// The configuration in force, as TOML.
    fn configuration(&self) -> PyResult<String> {
        self.laboratory()?.config.to_toml().map_err(fail)
    }

    /// Completes the record, if there is one.
    fn finish(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.laboratory()?.finish().map_err(fail))
    }
}

impl Simulator {
    fn laboratory(&self) -> PyResult<MutexGuard<'_, Laboratory>> {
        let panicked = |_| fail("the simulation has panicked before");
        self.0.lock().map_err(panicked)
    }
}

/// The keys of `[truth]`: name, range and meaning of each.
#[pyfunction]
pub(crate) fn truth_keys() -> Vec<(String, &'static str, &'static str)> {
    TRUTH_KEYS
        .iter()
        .map(|key| {
            let name = format!("{}.{}", key.section, key.name);
            (name, key.range, key.help.trim())
        })
        .collect()
}
