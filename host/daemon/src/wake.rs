//! A flag that ends threads while they wait for files.

use std::{
    io,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    sync::Arc,
    time::Duration,
};

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};

/// Asks threads to end, and wakes those that wait with it.
#[derive(Clone, Debug)]
pub(crate) struct StopFlag(Arc<OwnedFd>);

/// Why a thread woke up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Woken {
    /// One of its files is readable or has hung up.
    Ready,
    /// The timeout has passed.
    Timeout,
    /// The flag has been raised.
    Stop,
}

impl StopFlag {
    pub(crate) fn new() -> io::Result<Self> {
        Ok(Self(Arc::new(eventfd(
            0,
            EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK,
        )?)))
    }

    /// Raises the flag, for ever.
    pub(crate) fn raise(&self) {
        // It fails only after 2^64 - 2 calls.
        let _ = rustix::io::write(&*self.0, &1_u64.to_ne_bytes());
    }

    /// Waits for the flag, the timeout or one of at most three `files`.
    pub(crate) fn wait(&self, files: &[BorrowedFd<'_>], timeout: Duration) -> Woken {
        let mut polled = heapless::Vec::<PollFd<'_>, 4>::new();
        for file in [self.0.as_fd()].iter().chain(files) {
            // The capacity is the flag and three files.
            let _ = polled.push(PollFd::from_borrowed_fd(*file, PollFlags::IN));
        }
        let timeout = Timespec {
            tv_sec: timeout.as_secs() as _,
            tv_nsec: timeout.subsec_nanos() as _,
        };
        // After an interruption by a signal, the caller polls and waits again.
        let _ = poll(&mut polled, Some(&timeout));
        let ready = |file: &PollFd<'_>| !file.revents().is_empty();
        match polled.split_first() {
            Some((stop, _)) if ready(stop) => Woken::Stop,
            Some((_, files)) if files.iter().any(ready) => Woken::Ready,
            _ => Woken::Timeout,
        }
    }
}
