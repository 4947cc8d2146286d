//! System calls that neither the standard library nor rustix offers safely.

#![expect(unsafe_code, reason = "calls of the C library, each with its reason")]

use std::{
    io,
    mem::MaybeUninit,
    os::fd::{AsFd, AsRawFd, FromRawFd, IntoRawFd, OwnedFd},
};

use rtrb::Producer;
use serialport::TTYPort;

/// Takes the open file out of a serial port.
pub(crate) fn file_of(port: TTYPort) -> OwnedFd {
    // SAFETY: the port gives up its open descriptor, which has no other owner.
    unsafe { OwnedFd::from_raw_fd(port.into_raw_fd()) }
}

/// The number of bytes in the output queue of a line.
pub(crate) fn queued_output(line: &impl AsFd) -> io::Result<usize> {
    let mut queued: libc::c_int = 0;
    // SAFETY: the descriptor is open for the length of the borrow, and TIOCOUTQ stores one
    // int in `queued`.
    let result = unsafe { libc::ioctl(line.as_fd().as_raw_fd(), libc::TIOCOUTQ, &raw mut queued) };
    if result == -1 {
        return Err(io::Error::last_os_error());
    }
    Ok(usize::try_from(queued).unwrap_or(0))
}

/// Schedules the calling thread with `SCHED_FIFO` at `priority`. Threads that it starts
/// have the default scheduling.
pub(crate) fn schedule_fifo(priority: u8) -> io::Result<()> {
    let parameters = libc::sched_param {
        sched_priority: priority.into(),
    };
    // SAFETY: the parameters outlive the call, which changes this thread only.
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

/// Writes to all free slots of a ring, so that a later write causes no page fault.
pub(crate) fn touch_room<T>(ring: &mut Producer<T>) {
    let room = ring.slots();
    if let Ok(mut chunk) = ring.write_chunk_uninit(room) {
        let (first, second) = chunk.as_mut_slices();
        for slots in [first, second] {
            // SAFETY: the slots stay uninitialised and are not committed to the ring.
            unsafe { slots.as_mut_ptr().write_bytes(0, slots.len()) };
        }
    }
}

/// Writes to the next `BYTES` of the calling thread's stack, so that a later write causes
/// no page fault.
#[inline(never)]
pub(crate) fn touch_stack<const BYTES: usize>() {
    let mut room = MaybeUninit::<[u8; BYTES]>::uninit();
    // SAFETY: every offset is below the length; volatile writes are not optimised away.
    unsafe {
        let start = room.as_mut_ptr().cast::<u8>();
        for page in (0..BYTES).step_by(1_024) {
            start.add(page).write_volatile(0);
        }
    }
}
