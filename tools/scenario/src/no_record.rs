//! A build without the feature `records`: no drive can be recorded.

use std::path::Path;

use singletrack_core::Config;

use crate::virtual_drive::VirtualDrive;

/// This program writes no records.
#[derive(Debug, thiserror::Error)]
#[error("this program was built without the feature \"records\": it writes no record")]
pub struct VirtualRecordError;

/// There is none.
pub enum VirtualRecord {}

impl VirtualRecord {
    /// Refuses to start a record.
    ///
    /// # Errors
    ///
    /// Always.
    pub fn start(
        _path: Option<&Path>,
        _drive: &mut VirtualDrive,
        _config: &Config,
        _seed: u64,
    ) -> Result<Self, VirtualRecordError> {
        Err(VirtualRecordError)
    }

    /// Is never called.
    ///
    /// # Errors
    ///
    /// Never.
    pub fn into_bytes(self, _drive: &mut VirtualDrive) -> Result<Vec<u8>, VirtualRecordError> {
        match self {}
    }

    /// Is never called.
    ///
    /// # Errors
    ///
    /// Never.
    pub fn write(&mut self, _drive: &mut VirtualDrive) -> Result<(), VirtualRecordError> {
        match *self {}
    }

    /// Is never called.
    ///
    /// # Errors
    ///
    /// Never.
    pub fn finish(self, _drive: &mut VirtualDrive) -> Result<(), VirtualRecordError> {
        match self {}
    }
}
