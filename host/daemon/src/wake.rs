//! A flag that wakes whoever polls it.

use std::{
    io,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    sync::Arc,
    time::Duration,
};

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};

/// Tells threads to end, wherever they wait.
#[derive(Clone, Debug)]
pub(crate) struct StopFlag(Arc<OwnedFd>);

/// What a thread was woken by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Woken {
    /// One of its files has something to say.
    Ready,
    /// Time is up.
    Timeout,
    /// It is to end.
    Stop,
}

impl StopFlag {
    pub(crate) fn new() -> io::Result<Self> {
        Ok(Self(Arc::new(eventfd(
            0,
            EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK,
        )?)))
    }

    /// Sets the flag for good.
    pub(crate) fn raise(&self) {
        // It only fails when the flag has been set 2^64 - 2 times.
        let _ = rustix::io::write(&*self.0, &1_u64.to_ne_bytes());
    }

    /// Waits for `files`, of which there are at most two.
    pub(crate) fn wait(&self, files: &[BorrowedFd<'_>], timeout: Duration) -> Woken {
        let mut polled = heapless::Vec::<PollFd<'_>, 3>::new();
        for file in [self.0.as_fd()].iter().chain(files) {
            // The capacity is that of the contract.
            let _ = polled.push(PollFd::from_borrowed_fd(*file, PollFlags::IN));
        }
        let timeout = Timespec {
            tv_sec: timeout.as_secs() as _,
            tv_nsec: timeout.subsec_nanos() as _,
        };
        // Interrupted by a signal, whoever waits looks around and waits again.
        let _ = poll(&mut polled, Some(&timeout));
        let ready = |file: &PollFd<'_>| !file.revents().is_empty();
        match polled.split_first() {
            Some((stop, _)) if ready(stop) => Woken::Stop,
            Some((_, files)) if files.iter().any(ready) => Woken::Ready,
            _ => Woken::Timeout,
        }
    }
}
