//! Why a dump failed.

use std::io;

use singletrack_api::ClientError;
use singletrack_record::RecordError;
use singletrackd::serial_port::PortError;

/// Why a dump failed.
#[derive(Debug, thiserror::Error)]
pub enum DumpError {
    /// The record can't be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The serial port can't be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The connection to the daemon broke.
    #[error(transparent)]
    Lost(#[from] ClientError),
    /// The output can't be written.
    #[error("can't write to standard output: {0}")]
    Output(#[from] io::Error),
    /// Anything else: a text which says what to do.
    #[error("{0}")]
    Other(String),
}
