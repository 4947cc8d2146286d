//! The daemon's control socket: the native half of `singletrack.Car` for a real car.

use std::{
    path::PathBuf,
    process,
    sync::{
        Mutex,
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

use pyo3::{exceptions::PyConnectionError, prelude::*, types::PyDict};
use pythonize::{depythonize, pythonize};
use singletrack_api::{ClientError, Connection as Client, Reply, Request};

use crate::setup::{fail, refuse, seconds};

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
