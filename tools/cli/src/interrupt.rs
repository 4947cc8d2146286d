//! Ctrl-C ends a program as its last second does: what was begun is completed, and
//! nothing is left behind.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use tokio::{
    runtime,
    signal::unix::{SignalKind, signal},
};

/// Whether Ctrl-C was pressed.
#[derive(Clone, Debug, Default)]
pub(crate) struct Interrupt(Arc<AtomicBool>);

/// What a shell expects of a program that was interrupted.
const EXIT_CODE: i32 = 130;

/// How often a signal is looked for.
const POLL: Duration = Duration::from_millis(50);

impl Interrupt {
    /// Listens for SIGINT, SIGTERM and SIGHUP; a second one ends the process at once.
    pub(crate) fn listen() -> io::Result<Self> {
        let runtime = runtime::Builder::new_current_thread().enable_io().build()?;
        let listened = |kind| {
            let _entered = runtime.enter();
            signal(kind)
        };
        let mut interrupt = listened(SignalKind::interrupt())?;
        let mut terminate = listened(SignalKind::terminate())?;
        let mut hangup = listened(SignalKind::hangup())?;
        let raised = Self::default();
        let asked = Arc::clone(&raised.0);
        let watch = async move {
            loop {
                tokio::select! {
                    _ = interrupt.recv() => {}
                    _ = terminate.recv() => {}
                    _ = hangup.recv() => {}
                }
                if asked.swap(true, Ordering::Relaxed) {
                    std::process::exit(EXIT_CODE);
                }
            }
        };
        let thread = thread::Builder::new().name("interrupt".to_owned());
        thread.spawn(move || runtime.block_on(watch))?;
        Ok(raised)
    }

    /// Whether a signal has come.
    pub(crate) fn is_raised(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Waits for a signal.
    pub(crate) fn wait(&self) {
        while !self.is_raised() {
            thread::sleep(POLL);
        }
    }
}
