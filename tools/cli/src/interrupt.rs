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
    signal::unix::{Signal, SignalKind, signal},
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
        let signals = {
            let _entered = runtime.enter();
            [
                signal(SignalKind::interrupt())?,
                signal(SignalKind::terminate())?,
                signal(SignalKind::hangup())?,
            ]
        };
        let interrupt = Self::default();
        let asked = interrupt.clone();
        thread::Builder::new()
            .name("interrupt".to_owned())
            .spawn(move || runtime.block_on(asked.watch(signals)))?;
        Ok(interrupt)
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

    async fn watch(self, [mut interrupt, mut terminate, mut hangup]: [Signal; 3]) {
        loop {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
                _ = hangup.recv() => {}
            }
            if self.0.swap(true, Ordering::Relaxed) {
                std::process::exit(EXIT_CODE);
            }
        }
    }
}
