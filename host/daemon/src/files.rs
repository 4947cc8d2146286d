//! The thread that writes files and looks at the disk: an SD card may take seconds for a sync, and
//! states, log and record of a drive do not wait for it.

use std::{
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, Sender},
    },
    time::{Duration, Instant},
};

use singletrack_core::Proof;
use singletrack_record::{Entry, Level, Log};

use crate::{
    clock::monotonic_ns, free_space::FreeSpace, shared_status::SharedStatus, state_file::StateFile,
};

/// Interval of the attempts to write a file that could not be written.
const RETRY: Duration = Duration::from_secs(10);

/// Interval at which the free space is looked at.
const LOOK: Duration = Duration::from_secs(2);

/// A configuration that counts as proved from now on, or no longer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ProofChange {
    Proved(Proof),
    Disproved(Proof),
}

/// The values of the thread.
pub(crate) struct Files {
    /// Where proved configurations are kept.
    pub(crate) state: StateFile,
    /// Free space for the record; `None` without a record.
    pub(crate) space: Option<FreeSpace>,
    pub(crate) status: Arc<SharedStatus>,
    /// Entries for the record.
    pub(crate) entries: Sender<Entry>,
}

impl Files {
    /// Runs until all senders of `changes` are gone.
    pub(crate) fn run(mut self, changes: &Receiver<ProofChange>) {
        let mut tried = Instant::now();
        let mut looked: Option<Instant> = None;
        loop {
            if looked.is_none_or(|looked| looked.elapsed() >= LOOK) {
                looked = Some(Instant::now());
                self.look();
            }
            if tried.elapsed() >= RETRY {
                tried = Instant::now();
                // The first failure has been logged.
                let _ = self.state.retry();
            }
            match changes.recv_timeout(LOOK) {
                Ok(change) => self.keep(change),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    let _ = self.state.retry();
                    return;
                }
            }
        }
    }

    fn keep(&mut self, change: ProofChange) {
        let kept = match change {
            ProofChange::Proved(proof) => self.state.add(proof).map_err(|error| {
                let text = format!(
                    "the proof can't be kept in state.directory: {error}; until it can, the first \
                     drive after a restart begins slowly again"
                );
                (Level::Warning, text)
            }),
            ProofChange::Disproved(proof) => self.state.remove(proof).map_err(|error| {
                let text = format!(
                    "the proof can't be removed from state.directory: {error}; delete proved.json \
                     there before the next start"
                );
                (Level::Error, text)
            }),
        };
        if let Err((level, text)) = kept {
            self.log(level, text);
        }
    }

    /// Publishes whether there is room for the record, and logs it when there no longer is.
    fn look(&self) {
        let Some(space) = &self.space else {
            return;
        };
        let warning = space.warning();
        let before = std::mem::replace(&mut self.status.latest().record_warning, warning.clone());
        if let Some(warning) = warning.filter(|_| before.is_none()) {
            self.log(Level::Warning, warning);
        }
    }

    fn log(&self, level: Level, text: String) {
        match level {
            Level::Error => tracing::error!("{text}"),
            _ => tracing::warn!("{text}"),
        }
        // An error means that the collector, and with it the record, has ended.
        let _ = self.entries.send(Entry::Log(Log {
            time_ns: monotonic_ns(),
            level,
            text,
        }));
    }
}
