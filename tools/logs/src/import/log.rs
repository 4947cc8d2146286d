//! A foreign log, and why it is not imported.

use std::{
    error::Error,
    path::{Path, PathBuf},
};

use singletrack_mocap::Observation;
use singletrack_record::RecordError;

use super::samples::Series;

/// Why a log was not imported.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A file can't be read.
    #[error("can't read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: Box<dyn Error + Send + Sync>,
    },
    /// The map or the log is invalid: where, why, and what to do.
    #[error("{0}")]
    Invalid(String),
    /// The record.
    #[error(transparent)]
    Record(#[from] RecordError),
}

impl ImportError {
    /// The error of a reader about this file.
    pub(super) fn read<E: Error + Send + Sync + 'static>(path: &Path) -> impl Fn(E) -> Self + Copy {
        |source| Self::Read {
            path: path.to_owned(),
            source: source.into(),
        }
    }

    /// What is invalid in this file.
    pub(super) fn file(path: &Path, why: impl AsRef<str>) -> Self {
        Self::Invalid(path.display().to_string() + why.as_ref())
    }
}

/// The contents of a log, each in the order of time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Log {
    /// The wall time of the first row, in ns since 1970; 0 if the log does not have it.
    pub(super) start_wall_ns: u64,
    /// The time of the last row.
    pub(super) end_ns: u64,
    /// Every pose of the log, usable or not, with its place as the number of its frame.
    pub(super) poses: Vec<Observation>,
    /// Forward and left acceleration in m/s², yaw rate in rad/s. `None` if the log has no IMU.
    pub(super) inertial: Option<Series<3>>,
    /// Speed of the rear axle from the motor, in m/s.
    pub(super) motor_speed: Series<1>,
    /// The steering angle that is commanded, in rad.
    pub(super) steering: Series<1>,
    /// The speed that is commanded, in m/s; `None` if the log has no such command.
    pub(super) speed_command: Option<Series<1>>,
    /// Changes between driving and not driving; `None` if the log does not say it.
    pub(super) driving: Option<Vec<(u64, bool)>>,
    /// The period of the ticks.
    pub(super) tick_ns: u64,
    /// From the first row to the first tick: with regular exposures, ticks come a fifth of a period
    /// after them, so that a pose is in the tick that follows it whatever its jitter.
    pub(super) phase_ns: u64,
}

impl Log {
    /// Whether the car is driven: always, if the log does not say it.
    pub(super) fn is_driving(&self, time_ns: u64) -> bool {
        let Some(changes) = &self.driving else {
            return true;
        };
        let after = changes.partition_point(|(change_ns, _)| *change_ns <= time_ns);
        let last = after.checked_sub(1).and_then(|place| changes.get(place));
        last.is_some_and(|(_, is_driving)| *is_driving)
    }

    /// A commanded value at a time; 0 before the first command.
    pub(super) fn command(series: &Series<1>, time_ns: u64) -> f64 {
        let [value] = series.at(time_ns).unwrap_or_default();
        value
    }
}
