//! What shows a drive to people, beside the daemon: the page for a browser (`page`), and the live
//! view for Foxglove, Lichtblick and PlotJuggler (`live`).
//!
//! Each is a client of the daemon's control socket and a server of its own, which takes no
//! commands. It watches the daemon only while somebody watches it (the page for 5 s more), and
//! connects again when the daemon restarts. The page is bounded in connections, memory and time; the
//! live view listens on loopback only. A viewer that hangs or is killed costs the daemon one place
//! among its watchers, and nothing else.

#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "what a test expects is compared within a tolerance"
    )
)]

#[cfg(feature = "live")]
pub mod live;
#[cfg(feature = "page")]
pub mod page;

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use singletrack_api::ClientError;
use tokio::sync::Notify;

/// The longest wait for an answer, and for the next line of a stream.
pub(crate) const PATIENCE: Duration = Duration::from_secs(2);

/// Interval at which a thread without viewers looks for one.
const IDLE: Duration = Duration::from_millis(50);

/// From a lost daemon to the next attempt.
const RETRY: Duration = Duration::from_secs(1);

/// From a refusal to the next attempt. The daemon has no place: others may need the next one more.
const RETRY_REFUSED: Duration = Duration::from_secs(10);

/// The thread that watches the daemon. It ends soon after this value is dropped.
#[derive(Debug)]
pub(crate) struct Follower(Arc<AtomicBool>);

impl Drop for Follower {
    fn drop(&mut self) {
        // It is not waited for: a daemon that hangs may hold it up.
        self.0.store(true, Ordering::Release);
    }
}

impl Follower {
    /// Starts the thread. It runs `follow` again and again, which returns when nobody watches or the
    /// daemon is lost.
    pub(crate) fn start(
        mut follow: impl FnMut() -> Result<(), ClientError> + Send + 'static,
    ) -> io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let has_stopped = move || stopped.load(Ordering::Acquire);
        let body = move || {
            let mut said = String::new();
            while !has_stopped() {
                let Err(error) = follow() else {
                    thread::sleep(IDLE);
                    continue;
                };
                let why = error.to_string();
                if why != said {
                    tracing::warn!("no daemon: {why}");
                    said = why;
                }
                let pause = match error {
                    ClientError::Refused(_) => RETRY_REFUSED,
                    _ => RETRY,
                };
                for _ in 0..pause.as_millis() / IDLE.as_millis() {
                    if has_stopped() {
                        break;
                    }
                    thread::sleep(IDLE);
                }
            }
        };
        let thread = thread::Builder::new().name("daemon".to_owned());
        thread.spawn(body)?;
        Ok(Self(stop))
    }
}

/// A thread that serves until this value is dropped.
#[derive(Debug)]
pub(crate) struct ServerThread {
    stop: Arc<Notify>,
    thread: Option<JoinHandle<()>>,
}

impl ServerThread {
    pub(crate) fn start(
        name: &str,
        serve: impl FnOnce(&Notify) + Send + 'static,
    ) -> io::Result<Self> {
        let stop = Arc::new(Notify::new());
        let asked = Arc::clone(&stop);
        let thread = thread::Builder::new().name(name.to_owned());
        Ok(Self {
            stop,
            thread: Some(thread.spawn(move || serve(&asked))?),
        })
    }
}

impl Drop for ServerThread {
    fn drop(&mut self) {
        self.stop.notify_one();
        if let Some(thread) = self.thread.take() {
            let name = thread.thread().name().unwrap_or_default().to_owned();
            if thread.join().is_err() {
                tracing::error!("the thread of the {name} view has panicked");
            }
        }
    }
}
