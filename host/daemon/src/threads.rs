//! The daemon's threads. None may end before it is asked to: a drive without its reader, its cameras
//! or its control socket must not go on.

use std::{
    any::Any,
    thread::{self, JoinHandle},
};

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
