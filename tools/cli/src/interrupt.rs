//! Ctrl-C ends a program as its last second does: what was begun is completed, and
//! nothing is left behind.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
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
            .spawn(move || runtime.block_on(asked.wait(signals)))?;
        Ok(interrupt)
    }

    /// Whether a signal has come.
    pub(crate) fn is_raised(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    async fn wait(self, [mut interrupt, mut terminate, mut hangup]: [Signal; 3]) {
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
