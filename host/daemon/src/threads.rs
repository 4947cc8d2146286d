//! The daemon's threads, and the flag that ends them while they wait for files. No thread may end before it
//! is asked to: a drive without its reader, its cameras or its control socket must not go on.

use std::{
    any::Any,
    io,
    os::fd::{AsFd, BorrowedFd, OwnedFd},
    sync::Arc,
    thread::{self, JoinHandle},
    time::Duration,
};

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use tracing::error;

/// A running thread with its name.
#[derive(Debug)]
pub(crate) struct NamedThread<T> {
    pub(crate) name: &'static str,
    handle: JoinHandle<T>,
}

impl<T: Send + 'static> NamedThread<T> {
    pub(crate) fn spawn(
        name: &'static str,
        body: impl FnOnce() -> T + Send + 'static,
    ) -> Result<Self, String> {
        let spawned = thread::Builder::new().name(name.to_owned()).spawn(body);
        let handle = spawned.map_err(|error| format!("can't start the {name} thread: {error}"))?;
        Ok(Self { name, handle })
    }
}

impl<T> NamedThread<T> {
    /// The handle that wakes it.
    pub(crate) fn thread(&self) -> &thread::Thread {
        self.handle.thread()
    }

    pub(crate) fn has_ended(&self) -> bool {
        self.handle.is_finished()
    }

    /// Waits for its end. A panic is logged with its message.
    pub(crate) fn join(self) -> Option<T> {
        let Self { name, handle } = self;
        match handle.join() {
            Ok(result) => Some(result),
            Err(panic) => {
                error!("the {name} thread has panicked: {}", message(&*panic));
                None
            }
        }
    }
}

/// The message of a panic.
pub(crate) fn message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("without a message")
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_thread_is_seen_and_a_panic_is_no_result() {
        let ends = NamedThread::spawn("ends", || 7).unwrap();
        let panics = NamedThread::spawn("panics", || panic!("planted {}", 1)).unwrap();
        while !(ends.has_ended() && panics.has_ended()) {
            thread::yield_now();
        }
        assert_eq!((panics.name, ends.join()), ("panics", Some(7)));
        assert_eq!(panics.join(), None::<()>);
        let panic = thread::spawn(|| panic!("planted {}", 2)).join();
        assert_eq!(message(&*panic.unwrap_err()), "planted 2");
    }
}
