//! The pilot of a record, with the recorded or another configuration.

use std::path::{Path, PathBuf};

use singletrack_core::{Config, ConfigError};
use singletrack_logs::import;
use singletrack_pilot::PilotConfig;
use singletrack_record::{Entry, Reader, RecordError, Replay, Topic};

use super::{Change, ChangeError, change};

/// Why the pilot can't be made.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// The record can't be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// No pilot made the record.
    #[error(
        "{} was imported from the log of another program: no pilot made it, so there is nothing to repeat",
        .0.display()
    )]
    Imported(PathBuf),
    /// A change is invalid.
    #[error("--set {0}")]
    Change(#[from] ChangeError),
    /// The changes and the rest of the configuration do not go together.
    #[error("with --set, configuration {number} of {}: {source}", path.display())]
    Changed {
        /// The record.
        path: PathBuf,
        /// Its number; 1 for that of the start.
        number: u32,
        /// What the daemon says of it.
        source: Box<ConfigError>,
    },
    /// The changes reach nothing that is replayed.
    #[error(
        "--set {}: the pilot reads nothing of that; a replay shows what changes in its sections, \
         such as law, outer_loop, reference, limits, estimator, supervisor, watch and fence",
        .0.join(" --set ")
    )]
    Unread(Vec<String>),
    /// The configuration in the record is not one of this version.
    #[error(
        "configuration {number} of {} is not one that this version of singletrack takes: {source}",
        path.display()
    )]
    Config {
        /// The record.
        path: PathBuf,
        /// Its number; 1 for that of the start.
        number: u32,
        /// What the daemon says of it.
        source: Box<ConfigError>,
    },
}

/// A pilot with the configurations of a record, all of them changed by `changes`.
pub(super) fn pilot(path: &Path, changes: &[Change]) -> Result<Replay, SourceError> {
    let mut reader = Reader::open(path)?.only(&[Topic::Configuration]);
    if reader.meta().software.contains_key(import::SOFTWARE) {
        return Err(SourceError::Imported(path.to_owned()));
    }
    let start = reader.meta().configuration.clone();
    let mut replay = Replay::new(configuration(path, 1, &start, changes)?);
    // Nearly no record has another one.
    if reader.message_count(Topic::Configuration) == Some(0) {
        return Ok(replay);
    }
    for entry in reader.by_ref() {
        if let Entry::Configuration(record) = entry? {
            let number = record.number;
            let pilot = configuration(path, number, &record.toml, changes)?;
            replay.configuration(number, pilot);
        }
    }
    Ok(replay)
}

fn configuration(
    path: &Path,
    number: u32,
    toml: &str,
    changes: &[Change],
) -> Result<PilotConfig, SourceError> {
    let read = |toml: &str| -> Result<(PilotConfig, Config), ConfigError> {
        let config = Config::from_record(toml)?;
        Ok((config.pilot()?, config))
    };
    // Whose fault it is shows when it is tried without the changes.
    let (pilot, config) = read(toml).map_err(|source| SourceError::Config {
        path: path.to_owned(),
        number,
        source: Box::new(source),
    })?;
    if changes.is_empty() {
        return Ok(pilot);
    }
    let changed = read(&change::apply(toml, changes)?).map_err(|source| SourceError::Changed {
        path: path.to_owned(),
        number,
        source: Box::new(source),
    })?;
    if changed.0 == pilot && changed.1 != config {
        return Err(SourceError::Unread(
            changes.iter().map(Change::to_string).collect(),
        ));
    }
    Ok(changed.0)
}
