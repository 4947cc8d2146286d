//! The record of a drive in virtual time. The same seed gives the same bytes.

use std::path::Path;

use singletrack_core::{Config, record_meta};
use singletrack_record::{ClockMapping, Entry, Finished, RecordError, Recorder};

use crate::virtual_drive::VirtualDrive;

/// Why a record was not written.
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
    /// Starts the record at `path`, or in memory without one: see [`VirtualRecord::into_bytes`]. The
    /// drive must not have begun; it keeps its entries from now on.
    ///
    /// # Errors
    ///
    /// The file exists or can't be written.
    pub fn start(
        path: Option<&Path>,
        drive: &mut VirtualDrive,
        config: &Config,
        seed: u64,
    ) -> Result<Self, VirtualRecordError> {
        let meta = record_meta(config, Some(seed), ClockMapping::VIRTUAL)?;
        drive.keep_entries();
        Ok(Self(match path {
            Some(path) => Recorder::create(path, &meta)?.without_timed_flushes(),
            None => Recorder::in_memory(&meta)?,
        }))
    }

    /// Writes the entries that the drive has kept since the last call.
    ///
    /// # Errors
    ///
    /// The file can't be written.
    pub fn write(&mut self, drive: &mut VirtualDrive) -> Result<(), VirtualRecordError> {
        for entry in drive.entries() {
            self.0.write(&entry)?;
        }
        Ok(())
    }

    /// Writes an entry that does not come from the drive.
    ///
    /// # Errors
    ///
    /// The file can't be written.
    pub fn entry(&mut self, entry: &Entry) -> Result<(), VirtualRecordError> {
        Ok(self.0.write(entry)?)
    }

    /// Writes the rest and completes the file.
    ///
    /// # Errors
    ///
    /// The file can't be written.
    pub fn finish(mut self, drive: &mut VirtualDrive) -> Result<Finished, VirtualRecordError> {
        self.write(drive)?;
        Ok(self.0.finish()?)
    }

    /// Writes the rest and returns the record that was written in memory.
    ///
    /// # Errors
    ///
    /// The record can't be completed.
    pub fn into_bytes(mut self, drive: &mut VirtualDrive) -> Result<Vec<u8>, VirtualRecordError> {
        self.write(drive)?;
        Ok(self.0.into_bytes()?)
    }
}
