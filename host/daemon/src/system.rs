//! What neither the standard library nor rustix offers safely.

#![expect(unsafe_code, reason = "calls of the C library, each with its reason")]

use std::{
    io,
    mem::MaybeUninit,
    os::fd::{AsFd, AsRawFd, FromRawFd, IntoRawFd, OwnedFd},
};

use rtrb::Producer;
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

/// Writes to all free room of a ring, so that it is there when it is needed: the
/// first write to a page that is not is a page fault.
pub(crate) fn touch_room<T>(ring: &mut Producer<T>) {
    let room = ring.slots();
    if let Ok(mut chunk) = ring.write_chunk_uninit(room) {
        let (first, second) = chunk.as_mut_slices();
        for slots in [first, second] {
            // SAFETY: whatever bytes are in it, a slot is still uninitialised; it
            // is not handed over.
            unsafe { slots.as_mut_ptr().write_bytes(0, slots.len()) };
        }
    }
}

/// Writes to so much of the calling thread's stack.
#[inline(never)]
pub(crate) fn touch_stack<const BYTES: usize>() {
    let mut room = MaybeUninit::<[u8; BYTES]>::uninit();
    // SAFETY: it is as long as that; the writes are volatile, so they happen.
    unsafe {
        let start = room.as_mut_ptr().cast::<u8>();
        for page in (0..BYTES).step_by(1_024) {
            start.add(page).write_volatile(0);
        }
    }
}
