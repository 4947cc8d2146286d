//! Records of a drive, one for each daemon.

use std::{
    mem,
    path::{Path, PathBuf},
};

use singletrack_core::{config::Config, record_meta};
use singletrack_record::{
    ClockMapping, ConfigurationRecord, Entry, RecordError, Recorder, TickRecord,
};

use crate::{SetupError, schedule::Schedule, tamper::Tamper};

/// The wall clock at the start of the simulation, in ns since 1970.
const WALL_NS: u64 = 1_700_000_000_000_000_000;

/// Collects the ticks of a drive. It changes nothing.
#[derive(Debug, Default)]
pub struct Recording {
    /// One for each daemon that was started.
    daemons: Vec<DaemonRecord>,
    /// A configuration that comes into force with the next tick.
    changed: Option<(u32, Config)>,
}

#[derive(Debug)]
struct DaemonRecord {
    config: Config,
    entries: Vec<Entry>,
}

impl Tamper for Recording {
    fn configuration(&mut self, number: u32, config: &mut Config) {
        if number == 1 {
            self.daemons.push(DaemonRecord {
                config: config.clone(),
                entries: Vec::new(),
            });
        } else {
            self.changed = Some((number, config.clone()));
        }
    }

    fn tick(&mut self, tick: &mut TickRecord) {
        let Some(daemon) = self.daemons.last_mut() else {
            return;
        };
        daemon.entries.push(Entry::Tick(tick.clone()));
        if let Some((number, config)) = self.changed.take()
            && let Ok(toml) = config.to_toml()
        {
            daemon
                .entries
                .push(Entry::Configuration(ConfigurationRecord {
                    time_ns: tick.start_ns,
                    number,
                    toml,
                }));
        }
    }
}

/// Why a record was not written.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The configuration of the schedule is invalid.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The file can't be written.
    #[error(transparent)]
    Record(#[from] RecordError),
}

impl Recording {
    /// Writes `seed-N.mcap`, and `seed-N-2.mcap` for a second daemon and so on.
    ///
    /// # Errors
    ///
    /// A file exists or can't be written.
    pub fn write(
        &mut self,
        folder: &Path,
        schedule: &Schedule,
    ) -> Result<Vec<PathBuf>, RecordingError> {
        let seed = schedule.seed;
        let mut paths = Vec::new();
        for (index, daemon) in mem::take(&mut self.daemons).into_iter().enumerate() {
            let path = folder.join(match index {
                0 => format!("seed-{seed}.mcap"),
                index => format!("seed-{seed}-{}.mcap", index + 1),
            });
            let start = ClockMapping {
                monotonic_ns: match daemon.entries.first() {
                    Some(Entry::Tick(tick)) => tick.start_ns,
                    _ => 0,
                },
                wall_ns: WALL_NS,
            };
            let meta = record_meta(&daemon.config, Some(seed), start).map_err(|error| {
                SetupError::Other {
                    part: "the daemon's configuration",
                    reason: error.to_string(),
                }
            })?;
            let mut recorder = Recorder::create(&path, &meta)?;
            for entry in &daemon.entries {
                recorder.write(entry)?;
            }
            recorder.finish()?;
            paths.push(path);
        }
        Ok(paths)
    }
}
