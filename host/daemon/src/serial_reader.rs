//! The thread of the serial reader: waits for the port or its bytes, and polls.

use std::{os::fd::AsFd, path::PathBuf, time::Duration};

use singletrack_core::{
    config::SerialSection,
    line::{Port, PortRead},
    serial::{ReaderCounters, SerialReader},
};
use tracing::{info, warn};

use crate::{
    clock::monotonic_ns,
    serial_port::{self, ReadHalf, WriteHalf},
    wake::{StopFlag, Woken},
};

/// The board's serial port.
struct Device {
    path: PathBuf,
    baud: u32,
    read: Option<ReadHalf>,
    /// The last error of an attempt to open it. An equal one is not logged again.
    last_error: String,
}

impl Port for Device {
    type Line = WriteHalf;

    fn open(&mut self) -> Option<WriteHalf> {
        match serial_port::open(&self.path, self.baud) {
            Ok((read, write)) => {
                info!(port = %self.path.display(), baud = self.baud, "serial port open");
                self.last_error.clear();
                self.read = Some(read);
                Some(write)
            }
            Err(error) => {
                let error = error.to_string();
                if error != self.last_error {
                    warn!("can't open the serial port: {error}");
                    self.last_error = error;
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
    stop: &StopFlag,
) -> ReaderCounters {
    let mut device = Device {
        path: config.port,
        baud: config.baud,
        read: None,
        last_error: String::new(),
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
            return reader.counters();
        }
    }
}
