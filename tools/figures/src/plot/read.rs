//! Reading a record, however it ended, and why it is not plotted.

use std::path::{Path, PathBuf};

use singletrack_record::{Ending, Meta, Reader, RecordError, Topic};
use toml::Table;

use super::drive::{Drive, Recording};
use crate::output::{WriteError, progress_bar};

/// A record that has been read.
#[derive(Clone, Debug)]
pub struct Record {
    /// The file that was read.
    pub path: PathBuf,
    /// What it says of itself.
    pub meta: Meta,
    /// The drives in it.
    pub recording: Recording,
    /// Notes for the reader of the figures: that the record is unfinished or damaged.
    pub notes: Vec<String>,
}

/// How often progress is shown, in entries.
const STEP: u64 = 1_000;

impl Record {
    /// Reads a record; if it is still unfinished, the file that holds it until then.
    /// Shows progress on a terminal.
    ///
    /// # Errors
    ///
    /// When nothing of it can be read.
    pub fn read(path: &Path) -> Result<Self, PlotError> {
        let mut reader = Reader::open(path)?.only(&[
            Topic::Tick,
            Topic::Log,
            Topic::Configuration,
            Topic::Drops,
        ]);
        let meta = reader.meta.clone();
        let progress = progress_bar(0, "{spinner} {msg}: {human_pos} entries");
        progress.set_message(format!("reading {}", path.display()));
        let mut recording = Recording::default();
        let mut notes = Vec::new();
        let mut entries: u64 = 0;
        let damage = reader.take_undamaged(|entry| {
            recording.take(entry);
            entries += 1;
            if entries.is_multiple_of(STEP) {
                progress.set_position(entries);
            }
        })?;
        notes.extend(damage.map(|damage| damage.to_string()));
        progress.finish_and_clear();
        if let Some(ending @ Ending::Unfinished { .. }) = reader.ending {
            notes.push(ending.to_string());
        }
        if recording.entries_dropped > 0 {
            notes.push(format!(
                "{} entries did not reach the record: the disk was too slow",
                recording.entries_dropped
            ));
        }
        let mut record = Self {
            path: path.to_owned(),
            meta,
            recording,
            notes,
        };
        record.place_points();
        Ok(record)
    }

    /// Places P where the vehicle's front axle puts it, if the law believes another one.
    fn place_points(&mut self) {
        let drives = self.recording.drives.iter();
        let aside: Vec<f64> = drives
            .map(|drive| self.axle_error(drive).unwrap_or(0.0))
            .collect();
        for (drive, aside) in self.recording.drives.iter_mut().zip(&aside) {
            for tick in drive.ticks.iter_mut().filter(|_| *aside != 0.0) {
                let [x, y] = tick.point;
                tick.point = [x - aside * tick.yaw.cos(), y - aside * tick.yaw.sin()];
            }
            drive.set_nominal();
        }
        if let Some(aside) = aside.into_iter().find(|aside| *aside != 0.0) {
            self.notes.push(format!(
                "law.front_axle_distance_m is {aside:.4} m more than vehicle.front_axle_distance_m: P is \
                 drawn where the vehicle's puts it, not where the law believes it"
            ));
        }
    }

    /// The distance by which the law believes the front axle to be ahead of the vehicle's, in m.
    fn axle_error(&self, drive: &Drive) -> Option<f64> {
        let settings = self.settings(drive);
        let distance = |section: &str| {
            let section = settings.get(section)?;
            section.get("front_axle_distance_m")?.as_float()
        };
        Some(distance("law")? - distance("vehicle")?)
    }

    /// The configuration that a drive was driven with; empty if the record does not hold it.
    pub(super) fn settings(&self, drive: &Drive) -> Table {
        let text = self.configuration(drive).unwrap_or_default();
        text.parse().unwrap_or_default()
    }

    /// The configuration that a drive was driven with, as TOML; none if the record
    /// does not hold it.
    pub fn configuration(&self, drive: &Drive) -> Option<&str> {
        match drive.configuration {
            None => Some(&self.meta.configuration),
            Some(number) => {
                let mut all = self.recording.configurations.iter();
                let record = all.find(|record| record.number == number)?;
                Some(&record.toml)
            }
        }
    }
}

/// Why plotting failed.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// The record can't be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// Nothing was given to plot.
    #[error("there is no record to plot: name one")]
    NoRecord,
    /// The record does not hold what is asked for.
    #[error("{}: {why}", path.display())]
    Missing {
        /// The record.
        path: PathBuf,
        /// What it lacks, and what there is instead.
        why: String,
    },
    /// A picture can't be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}
