//! What is replayed: the record, its configurations, and the span of ticks.

use std::{error::Error, path::Path, time::Duration};

use singletrack_core::{Config, ConfigError};
use singletrack_logs::import;
use singletrack_pilot::PilotConfig;
use singletrack_record::{Entry, Reader, Replay, TickRecord, Topic};

use super::{Change, change};

/// What has been replayed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Span {
    pub(super) ticks: u64,
    first_ns: u64,
    last_ns: u64,
}

impl Span {
    pub(super) fn add(&mut self, tick: &TickRecord) {
        if self.ticks == 0 {
            self.first_ns = tick.start_ns;
        }
        self.ticks += 1;
        self.last_ns = tick.start_ns;
    }

    /// From its beginning to `tick`, in s.
    pub(super) fn seconds_to(&self, tick: &TickRecord) -> f64 {
        let first_ns = if self.ticks == 0 {
            tick.start_ns
        } else {
            self.first_ns
        };
        tick.start_ns.saturating_sub(first_ns) as f64 * 1e-9
    }

    pub(super) fn pace(&self, took: Duration) -> String {
        let seconds = self.last_ns.saturating_sub(self.first_ns) as f64 * 1e-9;
        let took = took.as_secs_f64();
        format!(
            "{seconds:.2} s replayed in {took:.3} s: {:.0} times real time",
            seconds / took
        )
    }
}

/// A pilot with the configurations of a record, all of them changed by `changes`.
pub(super) fn pilot(path: &Path, changes: &[Change]) -> Result<Replay, Box<dyn Error>> {
    let mut reader = Reader::open(path)?.only(&[Topic::Configuration]);
    if reader.meta().software.contains_key(import::SOFTWARE) {
        let path = path.display();
        return Err(format!(
            "{path} was imported from the log of another program: no pilot made it, so there is \
             nothing to repeat"
        )
        .into());
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
) -> Result<PilotConfig, Box<dyn Error>> {
    let read = |toml: &str| -> Result<(PilotConfig, Config), ConfigError> {
        let config = Config::from_toml(toml)?;
        Ok((config.pilot()?, config))
    };
    // Whose fault it is shows when it is tried without the changes.
    let configuration = format!("configuration {number} of {}", path.display());
    let (pilot, config) = read(toml).map_err(|error| {
        format!("{configuration} is not one that this version of singletrack takes: {error}")
    })?;
    if changes.is_empty() {
        return Ok(pilot);
    }
    let applied = change::apply(toml, changes).map_err(|error| format!("--set {error}"))?;
    let changed =
        read(&applied).map_err(|error| format!("with --set, {configuration}: {error}"))?;
    if changed.0 == pilot && changed.1 != config {
        let changes: Vec<_> = changes.iter().map(Change::to_string).collect();
        let changes = changes.join(" --set ");
        return Err(format!(
            "--set {changes}: the pilot reads nothing of that; a replay shows what changes in its \
             sections, such as law, outer_loop, reference, limits, estimator, supervisor, watch and \
             fence"
        )
        .into());
    }
    Ok(changed.0)
}
