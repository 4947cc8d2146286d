//! The record of a drive in virtual time: the same bytes from the same seed.

use std::path::Path;

use singletrack_core::{Config, record_meta};
use singletrack_record::{ClockMapping, Entry, Finished, RecordError, Recorder};

use crate::virtual_drive::VirtualDrive;

/// What the clock on the virtual wall shows at the beginning: 2000-01-01, in ns
/// since 1970.
const EPOCH_NS: u64 = 946_684_800_000_000_000;

/// Why there is no record.
#[derive(Debug, thiserror::Error)]
pub enum VirtualRecordError {
    /// The file.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The configuration.
    #[error("can't write the configuration into the record: {0}; every path in it must be UTF-8")]
    Configuration(#[from] toml::ser::Error),
}

/// A record that a [`VirtualDrive`] is written to.
pub struct VirtualRecord(Recorder);

impl VirtualRecord {
    /// Starts the record at `path` and has the drive, which has not yet begun, keep
    /// its entries.
    ///
    /// # Errors
    ///
    /// When the file exists or can't be written.
    pub fn start(
        path: &Path,
        drive: &mut VirtualDrive,
        config: &Config,
        seed: u64,
    ) -> Result<Self, VirtualRecordError> {
        let start = ClockMapping {
            monotonic_ns: 0,
            wall_ns: EPOCH_NS,
        };
        let meta = record_meta(config, Some(seed), start)?;
        drive.keep_entries();
        Ok(Self(Recorder::create(path, &meta)?.without_timed_flushes()))
    }

    /// Writes what the drive has kept since the last time.
    ///
    /// # Errors
    ///
    /// When the file can't be written.
    pub fn write(&mut self, drive: &mut VirtualDrive) -> Result<(), VirtualRecordError> {
        for entry in drive.entries() {
            self.0.write(&entry)?;
        }
        Ok(())
    }

    /// Writes an entry that the drive does not know of.
    ///
    /// # Errors
    ///
    /// When the file can't be written.
    pub fn entry(&mut self, entry: &Entry) -> Result<(), VirtualRecordError> {
        Ok(self.0.write(entry)?)
    }

    /// Writes the rest and completes the file.
    ///
    /// # Errors
    ///
    /// When the file can't be written.
    pub fn finish(mut self, drive: &mut VirtualDrive) -> Result<Finished, VirtualRecordError> {
        self.write(drive)?;
        Ok(self.0.finish()?)
    }
}
