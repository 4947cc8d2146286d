//! The record of a run: its file name, and its start.

use core::fmt;
use std::{
    error::Error,
    fs,
    path::{Path, PathBuf},
};

use singletrack_core::{Config, record_meta};
use singletrack_record::{
    ClockMapping, FeedInput, RecordError, Recorder, RecorderThread, feed, part_path,
};

use crate::clock::compact_utc;

/// Entries that may wait for the disk: about 3 s at 350 per second.
const CAPACITY: usize = 1_024;

/// What to do about a record that can't be created.
const FIX: &str = "choose another record.directory, or set record.enabled = false";

/// A record that is being written.
pub(crate) struct RunningRecord {
    pub(crate) thread: RecorderThread,
    pub(crate) path: PathBuf,
}

impl fmt::Debug for RunningRecord {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("RunningRecord")
            .field("path", &self.path)
            .finish_non_exhaustive()
    }
}

/// Starts the record of a run, at `path` or under a new name in the configured folder.
/// Returns the ring for its entries too; `None` if records are disabled and no path is
/// given.
pub(crate) fn start(
    config: &Config,
    path: Option<PathBuf>,
    seed: Option<u64>,
    start: ClockMapping,
) -> Result<Option<(RunningRecord, FeedInput)>, String> {
    if path.is_none() && !config.record.enabled {
        return Ok(None);
    }
    let meta = record_meta(config, seed, start).map_err(|error| {
        format!(
            "can't write the configuration into the record: {error}; every path in it must be UTF-8"
        )
    })?;
    let path = match path {
        Some(path) => path,
        None => {
            let directory = &config.record.directory;
            fs::create_dir_all(directory).map_err(|error| {
                let directory = directory.display();
                format!("can't make record.directory {directory}: {error}; {FIX}")
            })?;
            free_name(directory, &compact_utc(start.wall_ns))
        }
    };
    let refused = |error: RecordError| format!("{error}; {FIX}");
    let recorder = Recorder::create(&path, &meta).map_err(refused)?;
    let (input, output) = feed(CAPACITY);
    let thread = RecorderThread::start(recorder, output, |_| {}).map_err(refused)?;
    Ok(Some((RunningRecord { thread, path }, input)))
}

/// The error with its causes, the deepest one first: it says, for instance, that the disk is full.
pub(crate) fn with_causes(error: &RecordError) -> String {
    let mut causes = Vec::new();
    let mut cause = error.source();
    while let Some(error) = cause {
        causes.push(error.to_string());
        cause = error.source();
    }
    let mut text = error.to_string();
    let Some(deepest) = causes.last() else {
        return text;
    };
    // Said once.
    for cause in causes.iter().rev() {
        text = text.replace(&format!(": {cause}"), "");
    }
    format!("{deepest}: {text}")
}

/// A name that no file has yet: two daemons may start in the same second.
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
    use std::{ffi::OsStr, io, os::unix::ffi::OsStrExt};

    use super::*;

    const START: ClockMapping = ClockMapping {
        monotonic_ns: 0,
        wall_ns: 0,
    };

    #[test]
    fn the_deepest_cause_of_a_record_that_ends_comes_first_and_once() {
        let full = || io::Error::from_raw_os_error(28);
        let path = PathBuf::from("/r.mcap.part");
        let io = RecordError::Io {
            action: "sync",
            path: path.clone(),
            source: full(),
        };
        let write = RecordError::Write {
            path,
            source: Box::new(full().into()),
        };
        let cause = "No space left on device (os error 28)";
        assert_eq!(
            with_causes(&io),
            format!("{cause}: can't sync /r.mcap.part")
        );
        let text = with_causes(&write);
        assert!(
            text.starts_with(&format!("{cause}: can't write /r.mcap.part")),
            "{text}"
        );
        assert_eq!(text.matches("No space").count(), 1, "{text}");
    }

    #[test]
    fn a_configuration_that_can_not_be_recorded_is_an_error_and_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = Config::from_toml(include_str!("../singletrackd.example.toml")).unwrap();
        config.record.directory = folder.path().join("records");
        config.serial.port = PathBuf::from(OsStr::from_bytes(b"/dev/\xff"));
        let error = start(&config, None, None, START).err().unwrap();
        assert!(error.contains("must be UTF-8"), "{error}");
        assert!(!config.record.directory.exists());
        config.record.enabled = false;
        assert!(start(&config, None, None, START).unwrap().is_none());
    }
}
