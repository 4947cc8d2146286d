//! The files of the daemon on a thread of their own, and the room that is left for them.

use std::{
    io,
    path::PathBuf,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, Sender},
    },
    time::{Duration, Instant},
};

use rustix::fs::statvfs;
use singletrack_core::Proof;
use singletrack_record::{Entry, Level};

use crate::{clock::monotonic_ns, log::logged, shared_status::SharedStatus, state_file::StateFile};

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
        // An error means that the collector, and with it the record, has ended.
        let _ = self.entries.send(logged(monotonic_ns(), level, text));
    }
}

/// A megabyte, as disks are sold.
const MB: u64 = 1_000_000;

/// A folder, and what must be free on its disk.
#[derive(Clone, Debug)]
pub(crate) struct FreeSpace {
    /// The folder of the record.
    pub(crate) directory: PathBuf,
    /// `record.min_free_mb`.
    pub(crate) min_free_mb: u32,
}

impl FreeSpace {
    /// Why a record soon ends; `None` while there is room, and if the system does not say.
    pub(crate) fn warning(&self) -> Option<String> {
        let free_mb = self.free_mb().ok()?;
        (free_mb < u64::from(self.min_free_mb)).then(|| {
            format!(
                "the disk of the records is nearly full: {free_mb} MB are free in {}, and \
                 record.min_free_mb is {}. Move or delete old records: once it is full, nothing is \
                 recorded",
                self.directory.display(),
                self.min_free_mb,
            )
        })
    }

    fn free_mb(&self) -> io::Result<u64> {
        let disk = statvfs(&self.directory)?;
        // Without what is reserved for root.
        Ok(disk.f_bavail.saturating_mul(disk.f_frsize) / MB)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_with_less_than_the_limit_is_a_warning_with_folder_and_both_values() {
        let folder = tempfile::tempdir().unwrap();
        let space = |min_free_mb| FreeSpace {
            directory: folder.path().to_owned(),
            min_free_mb,
        };
        let free_mb = space(0).free_mb().unwrap();
        assert!((1..u64::from(u32::MAX)).contains(&free_mb), "{free_mb}");
        assert_eq!(space(0).warning(), None);
        let warning = space(u32::MAX).warning().unwrap();
        for part in [
            "nearly full",
            &folder.path().display().to_string(),
            "record.min_free_mb is 4294967295",
        ] {
            assert!(warning.contains(part), "{warning}");
        }
        let gone = FreeSpace {
            directory: folder.path().join("gone"),
            min_free_mb: u32::MAX,
        };
        assert_eq!(gone.warning(), None);
    }
}
