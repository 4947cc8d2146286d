//! What neither the standard library nor rustix offers safely.

#![expect(unsafe_code, reason = "calls of the C library, each with its reason")]

use std::{
    io,
    os::fd::{AsFd, AsRawFd, FromRawFd, IntoRawFd, OwnedFd},
};

use serialport::TTYPort;

/// The open file of a serial port, which is not closed.
pub(crate) fn file_of(port: TTYPort) -> OwnedFd {
    // SAFETY: the port gives its open descriptor away and forgets it.
    unsafe { OwnedFd::from_raw_fd(port.into_raw_fd()) }
}

/// Bytes written to a line that have not left it yet.
pub(crate) fn queued_output(line: &impl AsFd) -> io::Result<usize> {
    let mut queued: libc::c_int = 0;
    // SAFETY: the descriptor is open for the length of the borrow, and
    // TIOCOUTQ stores one int, for which there is room.
    let result = unsafe { libc::ioctl(line.as_fd().as_raw_fd(), libc::TIOCOUTQ, &raw mut queued) };
    if result == -1 {
        return Err(io::Error::last_os_error());
    }
    Ok(usize::try_from(queued).unwrap_or(0))
}

/// Schedules the calling thread first in, first out at `priority`; threads that
/// it starts are not.
pub(crate) fn schedule_fifo(priority: u8) -> io::Result<()> {
    let parameters = libc::sched_param {
        sched_priority: priority.into(),
    };
    // SAFETY: the parameters outlive the call, which changes this thread alone.
    let result = unsafe {
        libc::sched_setscheduler(
            0,
            libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK,
            &raw const parameters,
        )
    };
    if result == -1 {
        return Err(io::Error::last_os_error());
    }
    Ok(())
}
