//! System calls that neither the standard library nor rustix offers safely; and the wait for the signals that
//! end the daemon or reload its configuration.

#![expect(unsafe_code, reason = "calls of the C library, each with its reason")]

use std::{
    io,
    mem::MaybeUninit,
    os::fd::{AsFd, AsRawFd, FromRawFd, IntoRawFd, OwnedFd},
    ptr,
    time::Duration,
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

/// The meaning of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Signal {
    /// SIGTERM or SIGINT: stop the car and end. The name is for the log.
    End(&'static str),
    /// SIGHUP: reload the configuration.
    Reload,
}

/// SIGTERM, SIGINT and SIGHUP, blocked in every thread and received by
/// [`wait`](Self::wait) only.
pub(crate) struct Signals(libc::sigset_t);

impl Signals {
    /// Blocks the signals for this thread and the threads that it starts from now on.
    pub(crate) fn block() -> io::Result<Self> {
        let mut set = MaybeUninit::<libc::sigset_t>::uninit();
        // SAFETY: sigemptyset initialises the set before its use; the signals exist; a null
        // pointer for the old mask is allowed.
        let (set, result) = unsafe {
            libc::sigemptyset(set.as_mut_ptr());
            let mut set = set.assume_init();
            for signal in [libc::SIGTERM, libc::SIGINT, libc::SIGHUP] {
                libc::sigaddset(&raw mut set, signal);
            }
            let result = libc::pthread_sigmask(libc::SIG_BLOCK, &raw const set, ptr::null_mut());
            (set, result)
        };
        if result != 0 {
            return Err(io::Error::from_raw_os_error(result));
        }
        Ok(Self(set))
    }

    /// Waits for a signal; `None` after the timeout.
    pub(crate) fn wait(&self, timeout: Duration) -> Option<Signal> {
        let timeout = libc::timespec {
            tv_sec: timeout.as_secs() as _,
            tv_nsec: timeout.subsec_nanos() as _,
        };
        // SAFETY: set and time outlive the call; a null pointer for the signal's details is
        // allowed.
        let signal =
            unsafe { libc::sigtimedwait(&raw const self.0, ptr::null_mut(), &raw const timeout) };
        match signal {
            libc::SIGTERM => Some(Signal::End("SIGTERM")),
            libc::SIGINT => Some(Signal::End("SIGINT")),
            libc::SIGHUP => Some(Signal::Reload),
            _ => None,
        }
    }
}
