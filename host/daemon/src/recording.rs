//! The record of a run: where it goes, and what it says of itself.

use std::{
    error::Error,
    fs, io,
    path::{Path, PathBuf},
};

use singletrack_core::{Config, record_meta};
use singletrack_record::{
    ClockMapping, FeedInput, RecordError, Recorder, RecorderThread, feed, part_path,
};

use crate::clock::compact_utc;

/// Entries that may wait for the disk: some 3 s at 350 a second.
const CAPACITY: usize = 1_024;

/// Why there is no record.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// No folder.
    #[error("can't make record.directory {}: {source}; choose another, or set record.enabled = false", path.display())]
    Directory {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The record can't tell with which configuration it was made.
    #[error("can't write the configuration into the record: {0}; every path in it must be UTF-8")]
    Configuration(#[from] toml::ser::Error),
    /// No file.
    #[error("{0}; choose another record.directory, or set record.enabled = false")]
    Record(#[from] RecordError),
}

/// Starts the record of a run: at `path`, or under a new name in the
/// configured folder. None if the configuration wants none and no path is given.
pub(crate) fn start(
    config: &Config,
    path: Option<PathBuf>,
    seed: Option<u64>,
    start: ClockMapping,
) -> Result<Option<(RecorderThread, FeedInput, PathBuf)>, RecordingError> {
    if path.is_none() && !config.record.enabled {
        return Ok(None);
    }
    let meta = record_meta(config, seed, start)?;
    let path = match path {
        Some(path) => path,
        None => {
            let directory = &config.record.directory;
            fs::create_dir_all(directory).map_err(|source| RecordingError::Directory {
                path: directory.clone(),
                source,
            })?;
            free_name(directory, &compact_utc(start.wall_ns))
        }
    };
    let recorder = Recorder::create(&path, &meta)?;
    let (input, output) = feed(CAPACITY);
    let thread = RecorderThread::start(recorder, vec![output], |_| {})?;
    Ok(Some((thread, input, path)))
}

/// An error with what is behind it: that a disk is full is known to the last in
/// the chain alone.
pub(crate) fn with_causes(error: &RecordError) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let word = error.to_string();
        if !text.contains(&word) {
            text += &format!(": {word}");
        }
        cause = error.source();
    }
    text
}

/// A name that no record has: two daemons may start in the same second.
fn free_name(directory: &Path, time: &str) -> PathBuf {
    (1..)
        .map(|number| match number {
            1 => format!("singletrack-{time}.mcap"),
            number => format!("singletrack-{time}-{number}.mcap"),
        })
        .map(|name| directory.join(name))
        .find(|path| !path.exists() && !part_path(path).exists())
        .unwrap_or_else(|| directory.join("singletrack.mcap"))
}

#[cfg(test)]
mod tests {
    use std::{ffi::OsStr, os::unix::ffi::OsStrExt};

    use super::*;

    const START: ClockMapping = ClockMapping {
        monotonic_ns: 0,
        wall_ns: 0,
    };

    #[test]
    fn a_configuration_that_can_not_be_written_is_an_error_and_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = Config::from_toml(include_str!("../singletrackd.example.toml")).unwrap();
        config.record.directory = folder.path().join("records");
        config.serial.port = PathBuf::from(OsStr::from_bytes(b"/dev/\xff"));
        let error = start(&config, None, None, START).err().unwrap();
        assert!(matches!(error, RecordingError::Configuration(_)), "{error}");
        assert!(!config.record.directory.exists());
        config.record.enabled = false;
        assert!(start(&config, None, None, START).unwrap().is_none());
    }
}
