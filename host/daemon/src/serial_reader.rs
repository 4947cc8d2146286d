//! The thread of the serial reader: waits for the port or its bytes, and polls.

use std::{os::fd::AsFd, path::PathBuf, sync::Arc, time::Duration};

use singletrack_core::{
    config::SerialSection,
    line::{Port, PortRead},
    serial::{ReaderCounters, SerialReader},
};
use tracing::{info, warn};

use crate::{
    clock::monotonic_ns,
    serial_port::{self, ReadHalf, WriteHalf},
    shared_status::SharedStatus,
    wake::{StopFlag, Woken},
};

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
        match serial_port::open(&self.path, self.baud) {
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

/// Runs until `stop` is raised. Returns the counters.
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
