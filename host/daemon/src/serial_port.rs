//! The serial port: opening, reading and writing it; and the thread of the serial reader, which waits
//! for the port or its bytes, and polls.

use std::{
    io,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use rustix::{
    fs::OFlags,
    termios::{ControlModes, OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr},
};
use singletrack_core::{
    config::SerialSection,
    line::{Line, OutputQueue, Port, PortRead, Sent},
    serial::{ReaderCounters, SerialReader},
};
use singletrack_link::Transmit;
use tracing::{info, warn};

use crate::{
    clock::monotonic_ns,
    shared_status::SharedStatus,
    system,
    threads::{StopFlag, Woken},
};

/// The read half of an open port.
#[derive(Debug)]
pub struct ReadHalf {
    file: OwnedFd,
}

/// The write half of an open port, for one thread.
#[derive(Debug)]
pub struct WriteHalf {
    file: OwnedFd,
    queue: OutputQueue,
    /// The last frame was written in part. The next one must be separated from it.
    torn: bool,
}

/// The longest frame, and a zero before it.
const BUFFER: usize = core::mem::size_of::<Transmit>() + 1;

/// Opens and locks the port without changing its DTR line, which resets an UNO.
///
/// # Errors
///
/// Why it can't be opened, and what to do about it.
pub fn open(path: &Path, baud: u32) -> Result<(ReadHalf, WriteHalf), String> {
    let name = path.display();
    let other = |reason: String| {
        format!("{name}: {reason}; is it the board's serial port, and does it support {baud} baud?")
    };
    let port = serialport::new(path.to_string_lossy(), baud)
        .open_native()
        .map_err(|error| match error.kind() {
            serialport::ErrorKind::Io(io::ErrorKind::NotFound) => format!(
                "{name}: no such device; plug the board in, or correct serial.port; if the port \
                 appears and goes again, remove the program brltty"
            ),
            serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied) => format!(
                "{name}: permission denied; add the user to the group dialout and log in again"
            ),
            serialport::ErrorKind::NoDevice
            | serialport::ErrorKind::Io(io::ErrorKind::WouldBlock) => format!(
                "{name}: in use by another program; stop it (a second singletrackd, a serial \
                 monitor, ModemManager)"
            ),
            _ => other(error.description),
        })?;
    let file = system::file_of(port);
    let prepared = || -> rustix::io::Result<OwnedFd> {
        // Closing the port must not drop DTR either.
        let mut settings = tcgetattr(&file)?;
        settings.control_modes.remove(ControlModes::HUPCL);
        tcsetattr(&file, OptionalActions::Now, &settings)?;
        // The queues hold bytes of an earlier connection.
        tcflush(&file, QueueSelector::IOFlush)?;
        rustix::fs::fcntl_setfl(&file, OFlags::NONBLOCK)?;
        rustix::io::fcntl_dupfd_cloexec(&file, 0)
    };
    let write = prepared().map_err(|error| other(error.to_string()))?;
    Ok((
        ReadHalf { file },
        WriteHalf {
            file: write,
            queue: OutputQueue::default(),
            torn: false,
        },
    ))
}

impl ReadHalf {
    /// Reads the bytes that wait. `None` if there are none; an error or zero bytes if the
    /// port has hung up.
    pub fn read(&self, buffer: &mut [u8]) -> Option<io::Result<usize>> {
        match rustix::io::read(&self.file, buffer) {
            Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => None,
            result => Some(result.map_err(io::Error::from)),
        }
    }
}

impl AsFd for ReadHalf {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

impl Line for WriteHalf {
    fn write_frame(&mut self, frame: &[u8]) -> Sent {
        // An error of a lost device shows in the write below.
        let queued = system::queued_output(&self.file).unwrap_or(0);
        if !self.queue.has_room(queued) {
            return Sent::Dropped;
        }
        let mut bytes = heapless::Vec::<u8, BUFFER>::new();
        let fits = (!self.torn || bytes.push(0).is_ok()) && bytes.extend_from_slice(frame).is_ok();
        if !fits {
            return Sent::Dropped;
        }
        let result = rustix::io::write(&self.file, &bytes);
        self.queue.wrote(result.unwrap_or(0));
        match result {
            Ok(count) if count == bytes.len() => {
                self.torn = false;
                Sent::Whole
            }
            Ok(0) | Err(_) => Sent::Dropped,
            Ok(_) => {
                self.torn = true;
                Sent::Dropped
            }
        }
    }
}

/// The board's serial port.
struct Device {
    path: PathBuf,
    baud: u32,
    read: Option<ReadHalf>,
    /// Holds the last error of an attempt to open it. An equal one is not logged again.
    status: Arc<SharedStatus>,
}

impl Port for Device {
    type Line = WriteHalf;

    fn open(&mut self) -> Option<WriteHalf> {
        match open(&self.path, self.baud) {
            Ok((read, write)) => {
                info!(port = %self.path.display(), baud = self.baud, "serial port open");
                self.status.latest().serial_error = None;
                self.read = Some(read);
                Some(write)
            }
            Err(error) => {
                let last = self.status.latest().serial_error.replace(error.clone());
                if last.as_ref() != Some(&error) {
                    warn!("can't open the serial port: {error}");
                }
                None
            }
        }
    }

    fn read(&mut self, buffer: &mut [u8]) -> PortRead {
        let reason = match self.read.as_ref().map(|port| port.read(buffer)) {
            Some(None) => return PortRead::Nothing,
            Some(Some(Ok(count @ 1..))) => return PortRead::Bytes(count),
            Some(Some(Ok(0))) => "end of file".to_owned(),
            Some(Some(Err(error))) => error.to_string(),
            None => "closed".to_owned(),
        };
        warn!(port = %self.path.display(), reason, "serial port hung up");
        PortRead::HungUp
    }

    fn close(&mut self) {
        self.read = None;
    }
}

/// Reads in a thread of its own until `stop` is raised. Returns the counters.
pub(crate) fn run(
    mut reader: SerialReader<WriteHalf>,
    config: SerialSection,
    status: Arc<SharedStatus>,
    stop: &StopFlag,
) -> ReaderCounters {
    let mut device = Device {
        path: config.port,
        baud: config.baud,
        read: None,
        status,
    };
    loop {
        let wait = reader.poll(&monotonic_ns, &mut device);
        let left = Duration::from_nanos(wait.until_ns.saturating_sub(monotonic_ns()));
        let port = device.read.as_ref().filter(|_| wait.readable);
        let woken = match port {
            Some(port) => stop.wait(&[port.as_fd()], left),
            None => stop.wait(&[], left),
        };
        if woken == Woken::Stop {
            return reader.counters;
        }
    }
}
