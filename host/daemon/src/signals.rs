//! The signals that end the daemon or reload its configuration.

#![expect(unsafe_code, reason = "calls of the C library, each with its reason")]

use std::{io, mem::MaybeUninit, ptr, time::Duration};

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
