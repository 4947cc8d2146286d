//! The control sockets of daemons: the native half of `singletrack.Car` for a real car, and of
//! `singletrack.Fleet` for several cars.

use std::{
    path::PathBuf,
    process,
    sync::{
        Mutex, MutexGuard,
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use pyo3::{
    exceptions::PyConnectionError,
    prelude::*,
    types::{IntoPyDict as _, PyDict},
};
use pythonize::{depythonize, pythonize};
use singletrack_api::{
    ClientError, Connection as Client, Fleet as Cars, FleetArm, FleetDrive as Drive, Reply, Request,
};

use crate::{fail, refuse, seconds};

/// The longest wait for a daemon that does not read.
const PATIENCE: Duration = Duration::from_secs(5);

/// Lines that are received, and not yet taken.
const LINES: usize = 1_000;

/// The longest wait without a look at the program's signals.
const SIGNALS: Duration = Duration::from_millis(50);

/// The longest wait of the thread that reads.
const READ: Duration = Duration::from_secs(3_600);

type Received = Result<Reply, ClientError>;

/// A connection; a thread reads its lines. It ends when Python forgets it.
///
/// It belongs to the process that made it: a copy by `fork` has no thread that reads, and must not
/// speak or hang up for the original.
#[pyclass(frozen, module = "singletrack._native")]
pub(crate) struct Connection {
    sending: Mutex<Client>,
    /// Not behind the lock of one who waits for a daemon that does not read.
    closing: Client,
    received: Mutex<Receiver<Received>>,
    process: u32,
}

#[pymethods]
impl Connection {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let client = py.detach(|| Client::open(&path, PATIENCE)).map_err(lost)?;
        let reading = client.try_clone().map_err(lost)?;
        let sending = client.try_clone().map_err(lost)?;
        let (lines, received) = sync_channel(LINES);
        thread::Builder::new()
            .name("singletrack-read".to_owned())
            .spawn(move || read(reading, &lines))
            .map_err(fail)?;
        Ok(Self {
            sending: Mutex::new(sending),
            closing: client,
            received: Mutex::new(received),
            process: process::id(),
        })
    }

    /// Sends a request with these keys.
    #[pyo3(signature = (command, **keys))]
    fn send(&self, py: Python<'_>, command: &str, keys: Option<Bound<'_, PyDict>>) -> PyResult<()> {
        self.check_process()?;
        let request = keys.unwrap_or_else(|| PyDict::new(py));
        request.set_item("command", command)?;
        let request: Request = depythonize(&request).map_err(refuse)?;
        py.detach(|| {
            let mut sending = self.sending.lock().map_err(fail)?;
            sending.send(&request).map_err(|error| match error {
                ClientError::Request(error) => refuse(error),
                error => {
                    // A part of the line may be sent: what follows would be read as its end.
                    self.closing.hang_up();
                    lost(error)
                }
            })
        })
    }

    /// The oldest line that was not taken; `None` after `wait` seconds.
    fn take<'py>(&self, py: Python<'py>, wait: f64) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.check_process()?;
        let (begun, wait) = (Instant::now(), seconds(wait)?);
        loop {
            let left = wait.saturating_sub(begun.elapsed());
            let received = py.detach(|| {
                let lines = self.received.lock().map_err(fail)?;
                Ok::<_, PyErr>(lines.recv_timeout(left.min(SIGNALS)))
            })?;
            match received {
                Ok(reply) => return Ok(Some(pythonize(py, &reply.map_err(lost)?)?)),
                Err(RecvTimeoutError::Disconnected) => return Err(lost(ClientError::Ended)),
                Err(RecvTimeoutError::Timeout) if left <= SIGNALS => return Ok(None),
                // For Ctrl-C.
                Err(RecvTimeoutError::Timeout) => py.check_signals()?,
            }
        }
    }

    /// Ends the connection.
    fn close(&self) {
        if self.check_process().is_ok() {
            self.closing.hang_up();
        }
    }
}

impl Connection {
    fn check_process(&self) -> PyResult<()> {
        if process::id() == self.process {
            return Ok(());
        }
        Err(PyConnectionError::new_err(
            "this connection belongs to the process that was copied; use a Car of your own",
        ))
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.close();
    }
}

/// Receives until the connection ends, or nobody takes what is received.
fn read(mut connection: Client, lines: &SyncSender<Received>) {
    loop {
        let received = match connection.receive_within(READ) {
            Ok(Some(reply)) => Ok(reply),
            Ok(None) => continue,
            Err(error) => Err(error),
        };
        let ended = received.is_err();
        if lines.send(received).is_err() || ended {
            return;
        }
    }
}

fn lost(error: ClientError) -> PyErr {
    PyConnectionError::new_err(error.to_string())
}

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

    /// The daemon's status by name, or `error` alone.
    fn status<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let answers = py.detach(|| self.cars.status(|| self.clock_ns()));
        let all = PyDict::new(py);
        for (answer, car) in answers.into_iter().zip(&self.cars.cars) {
            let shown = match answer {
                Ok((status, _)) => pythonize(py, &status)?,
                Err(why) => [("error", why)].into_py_dict(py)?.into_any(),
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
        let (now, start) = (Instant::now(), self.drive()?.start);
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
