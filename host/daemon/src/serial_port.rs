//! The serial port: how it is opened, and its write half.

use std::{
    io,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    path::{Path, PathBuf},
};

use rustix::{
    fs::OFlags,
    termios::{ControlModes, OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr},
};
use singletrack_core::{controller::Sent, line::Line};
use singletrack_link::Transmit;
use singletrack_protocol::{Drive, Message, frame_length};

use crate::system;

/// Why a port is not open.
#[derive(Debug, thiserror::Error)]
pub enum PortError {
    /// There is no such device.
    #[error("{}: no such device; plug the board in, or correct serial.port", .0.display())]
    NotFound(PathBuf),
    /// We may not.
    #[error("{}: permission denied; add the user to the group dialout and log in anew", .0.display())]
    Permission(PathBuf),
    /// Someone else has it.
    #[error("{}: in use by another program; stop it (a second singletrackd, a serial monitor, ModemManager)", .0.display())]
    Busy(PathBuf),
    /// It is no serial port, or does not do what one does.
    #[error("{}: {reason}; is it the board's serial port, and {baud} baud a rate that it knows?", path.display())]
    Other {
        /// The device.
        path: PathBuf,
        /// The rate.
        baud: u32,
        /// What the system says.
        reason: String,
    },
}

/// An open port: the half that is read.
#[derive(Debug)]
pub struct ReadHalf {
    file: OwnedFd,
}

/// The half that is written, by one thread.
#[derive(Debug)]
pub struct WriteHalf {
    file: OwnedFd,
    /// The last frame was written in part: the next must not be joined to it.
    torn: bool,
}

/// Length of a drive command on the wire.
const DRIVE_LENGTH: usize = frame_length(Drive::PAYLOAD_LENGTH);

/// A line that has not yet sent more than this takes another frame: two
/// commands wait at most.
const MAX_QUEUED: usize = DRIVE_LENGTH;

/// Room for the longest frame behind a zero.
const BUFFER: usize = core::mem::size_of::<Transmit>() + 1;

/// Opens a port for us alone, without touching its DTR line: on an UNO that is
/// the reset.
///
/// # Errors
///
/// What is wrong with the port, and what to do about it.
pub fn open(path: &Path, baud: u32) -> Result<(ReadHalf, WriteHalf), PortError> {
    let other = |reason: String| PortError::Other {
        path: path.to_owned(),
        baud,
        reason,
    };
    let port = serialport::new(path.to_string_lossy(), baud)
        .open_native()
        .map_err(|error| match error.kind() {
            serialport::ErrorKind::Io(io::ErrorKind::NotFound) => {
                PortError::NotFound(path.to_owned())
            }
            serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied) => {
                PortError::Permission(path.to_owned())
            }
            serialport::ErrorKind::NoDevice
            | serialport::ErrorKind::Io(io::ErrorKind::WouldBlock) => {
                PortError::Busy(path.to_owned())
            }
            _ => other(error.description),
        })?;
    let file = system::file_of(port);
    let prepared = || -> rustix::io::Result<OwnedFd> {
        // Closing must not drop DTR either.
        let mut settings = tcgetattr(&file)?;
        settings.control_modes.remove(ControlModes::HUPCL);
        tcsetattr(&file, OptionalActions::Now, &settings)?;
        // What waits there belongs to a connection of before.
        tcflush(&file, QueueSelector::IOFlush)?;
        rustix::fs::fcntl_setfl(&file, OFlags::NONBLOCK)?;
        rustix::io::fcntl_dupfd_cloexec(&file, 0)
    };
    let write = prepared().map_err(|error| other(error.to_string()))?;
    Ok((
        ReadHalf { file },
        WriteHalf {
            file: write,
            torn: false,
        },
    ))
}

impl ReadHalf {
    /// Reads what is there: none if nothing is, an error or zero bytes if the
    /// line has hung up.
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
        // A pseudo-terminal always says zero; a device that has gone says so
        // when it is written to.
        if system::queued_output(&self.file).unwrap_or(0) > MAX_QUEUED {
            return Sent::Dropped;
        }
        let mut bytes = heapless::Vec::<u8, BUFFER>::new();
        let fits = (!self.torn || bytes.push(0).is_ok()) && bytes.extend_from_slice(frame).is_ok();
        if !fits {
            return Sent::Dropped;
        }
        match rustix::io::write(&self.file, &bytes) {
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
