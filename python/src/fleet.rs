//! Several cars: the native half of `singletrack.Fleet`.

use std::{
    path::PathBuf,
    sync::{Mutex, MutexGuard},
    time::{Duration, Instant},
};

use pyo3::{prelude::*, types::PyDict};
use pythonize::pythonize;
use singletrack_api::{Fleet as Cars, FleetArm, FleetDrive as Drive, Request};

use crate::argument::{fail, refuse, seconds};

/// The longest wait without a look at the program's signals.
const SIGNALS: Duration = Duration::from_millis(50);

/// The cars of a file.
#[pyclass(frozen, module = "singletrack._native")]
pub(crate) struct Fleet {
    cars: Cars,
    /// The zero of the clock that the daemons' clocks are compared with.
    epoch: Instant,
}

#[pymethods]
impl Fleet {
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        Ok(Self {
            cars: Cars::read(&path).map_err(refuse)?,
            epoch: Instant::now(),
        })
    }

    /// Names and control sockets.
    fn sockets(&self) -> Vec<(String, PathBuf)> {
        let cars = self.cars.cars.iter();
        cars.map(|car| (car.name.clone(), car.socket())).collect()
    }

    /// By name, the daemon's status, or `error` alone.
    fn status<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let answers = py.detach(|| self.cars.status(|| self.clock_ns()));
        let all = PyDict::new(py);
        for (answer, car) in answers.into_iter().zip(&self.cars.cars) {
            let shown = match answer {
                Ok((status, _)) => pythonize(py, &status)?,
                Err(why) => {
                    let only = PyDict::new(py);
                    only.set_item("error", why)?;
                    only.into_any()
                }
            };
            all.set_item(&car.name, shown)?;
        }
        Ok(all)
    }

    /// Tells all to disarm, or to stop.
    fn tell(&self, py: Python<'_>, stops: bool) -> PyResult<()> {
        let request = match stops {
            true => Request::Stop {},
            false => Request::DISARM,
        };
        py.detach(|| self.cars.tell(&request)).map_err(fail)
    }

    /// Arms all, if all are ready.
    fn arm(
        &self,
        py: Python<'_>,
        start_in: f64,
        together: bool,
        uncalibrated: bool,
    ) -> PyResult<FleetDrive> {
        let options = FleetArm {
            start_in: seconds(start_in)?,
            together,
            uncalibrated,
        };
        let begin = || Drive::begin(&self.cars, &options, || self.clock_ns());
        Ok(FleetDrive(Mutex::new(py.detach(begin).map_err(fail)?)))
    }
}

impl Fleet {
    fn clock_ns(&self) -> u64 {
        self.epoch.elapsed().as_nanos() as u64
    }
}

/// The drive of all cars.
#[pyclass(frozen, module = "singletrack._native")]
pub(crate) struct FleetDrive(Mutex<Drive>);

#[pymethods]
impl FleetDrive {
    /// The time since the references began, in s; negative before.
    fn time(&self) -> PyResult<f64> {
        let (now, start) = (Instant::now(), self.drive()?.start());
        let since = now.saturating_duration_since(start).as_secs_f64();
        Ok(since - start.saturating_duration_since(now).as_secs_f64())
    }

    /// Holds the drives for this time, at least once. Whether one goes on.
    fn hold(&self, py: Python<'_>, time: f64) -> PyResult<bool> {
        let (begun, time) = (Instant::now(), seconds(time)?);
        loop {
            let goes_on = py.detach(|| {
                let mut drive = self.drive()?;
                let slice = Instant::now();
                while !drive.is_over() {
                    drive.step();
                    if begun.elapsed() >= time || slice.elapsed() >= SIGNALS {
                        break;
                    }
                }
                drive.ends().map_err(fail)?;
                Ok::<_, PyErr>(!drive.is_over())
            })?;
            if !goes_on || begun.elapsed() >= time {
                return Ok(goes_on);
            }
            // For Ctrl-C.
            py.check_signals()?;
        }
    }

    /// Slows all cars down. They go on to be listened to by `hold`.
    fn disarm(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.drive().map(|mut drive| drive.disarm()))
    }

    /// What the daemons have warned of since the last call.
    fn warnings(&self) -> PyResult<Vec<String>> {
        Ok(self.drive()?.warnings())
    }

    /// The cars whose drives have ended: name, mode and reason.
    fn ends(&self) -> PyResult<Vec<(String, String, Option<String>)>> {
        let ends = self.drive()?.ends().map_err(fail)?;
        let end = ends.into_iter().map(|car| {
            let (mode, reason) = (car.ended.mode, car.ended.reason);
            (car.name, mode.to_string(), reason.map(|it| it.to_string()))
        });
        Ok(end.collect())
    }
}

impl FleetDrive {
    fn drive(&self) -> PyResult<MutexGuard<'_, Drive>> {
        self.0.lock().map_err(fail)
    }
}
