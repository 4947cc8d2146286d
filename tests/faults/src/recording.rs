//! The records that the daemons of a drive would leave.

use std::{
    mem,
    path::{Path, PathBuf},
};

use singletrack_core::record_meta;
use singletrack_record::{ClockMapping, Entry, RecordError, Recorder, TickRecord};

use crate::{SetupError, schedule::Schedule, setting, tamper::Tamper};

/// What the clock on the wall shows when everything is switched on, in ns since 1970.
const WALL_NS: u64 = 1_700_000_000_000_000_000;

/// Takes the ticks of a drive. Tampers with nothing.
#[derive(Debug, Default)]
pub struct Recording {
    /// One list for every daemon that was started.
    daemons: Vec<Vec<TickRecord>>,
}

impl Tamper for Recording {
    fn tick(&mut self, tick: &mut TickRecord) {
        if tick.index == 0 {
            self.daemons.push(Vec::new());
        }
        if let Some(ticks) = self.daemons.last_mut() {
            ticks.push(tick.clone());
        }
    }
}

/// Why there is no record.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The configuration of the schedule.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The file.
    #[error(transparent)]
    Record(#[from] RecordError),
}

impl Recording {
    /// Writes `seed-N.mcap`, and `seed-N-2.mcap` for a second daemon and so on.
    ///
    /// # Errors
    ///
    /// A file that exists or can't be written.
    pub fn write(
        &mut self,
        folder: &Path,
        schedule: &Schedule,
    ) -> Result<Vec<PathBuf>, RecordingError> {
        let config = setting::config(&schedule.situation)?;
        let seed = schedule.seed;
        let mut paths = Vec::new();
        for (index, ticks) in mem::take(&mut self.daemons).into_iter().enumerate() {
            let path = folder.join(match index {
                0 => format!("seed-{seed}.mcap"),
                index => format!("seed-{seed}-{}.mcap", index + 1),
            });
            let start = ClockMapping {
                monotonic_ns: ticks.first().map_or(0, |tick| tick.start_ns),
                wall_ns: WALL_NS,
            };
            let meta =
                record_meta(&config, Some(seed), start).map_err(|error| SetupError::Other {
                    part: "the daemon's configuration",
                    reason: error.to_string(),
                })?;
            let mut recorder = Recorder::create(&path, &meta)?;
            for tick in ticks {
                recorder.write(&Entry::Tick(tick))?;
            }
            recorder.finish()?;
            paths.push(path);
        }
        Ok(paths)
    }
}
