//! A foreign log, why it is not imported, and a summary of an import.

use std::{
    error::Error,
    fmt,
    path::{Path, PathBuf},
};

use singletrack_control::statistics::Arrivals;
use singletrack_mocap::Observation;
use singletrack_record::{RecordError, seconds_since};

use super::{FIRST_ROW_NS, samples::Series, times::Times};

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

/// A row or message that is before an earlier one by no more is sorted into its place, in ns: one
/// program has written what several threads measured. More is another log.
pub(super) const JITTER_NS: u64 = 2_000_000;

/// A duration as people write it.
pub(super) fn duration(ns: u64) -> String {
    let ms = ns as f64 * 1e-6;
    match ns {
        0..10_000_000 => format!("{ms:.2} ms"),
        10_000_000..1_000_000_000 => format!("{ms:.0} ms"),
        1_000_000_000..100_000_000_000 => format!("{:.2} s", 1e-3 * ms),
        _ => format!("{:.0} s", 1e-3 * ms),
    }
}

/// The contents of a log, each in the order of time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Log {
    /// The wall time of the first row, in ns since 1970; 0 if the log does not have it.
    pub(super) start_wall_ns: u64,
    /// Rows or messages that were sorted into their place.
    pub(super) sorted: u64,
    /// The time of the last row.
    pub(super) end_ns: u64,
    /// Whether the map has the rate of the exposures.
    pub(super) exposures_are_known: bool,
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
    /// 1 while the car is driven, else 0; `None` if the log does not say it.
    pub(super) driving: Option<Series<1>>,
    /// The period of the ticks.
    pub(super) tick_ns: u64,
    /// From the first row to the first tick: with regular exposures, ticks come a fifth of a period
    /// after them, so that a pose is in the tick that follows it whatever its jitter.
    pub(super) phase_ns: u64,
}

impl Log {
    /// Whether the car is driven: always, if the log does not say it.
    pub(super) fn is_driving(&self, time_ns: u64) -> bool {
        let driving = self.driving.as_ref();
        driving.is_none_or(|driving| Self::command(driving, time_ns) != 0.0)
    }

    /// A commanded value at a time; 0 before the first command.
    pub(super) fn command(series: &Series<1>, time_ns: u64) -> f64 {
        let [value] = series.at(time_ns).unwrap_or_default();
        value
    }
}

/// What a record has that was made of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Summary {
    /// From the first row to the last.
    pub duration_ns: u64,
    /// Poses that can be used, by the times of their arrival.
    pub poses: Arrivals,
    /// Poses with a number that is missing or not finite.
    pub rejected: u64,
    /// Poses that the log marks as not tracked.
    pub untracked: u64,
    /// Samples of the IMU in the log, before any interpolation; `None` if it has no IMU.
    pub inertial: Option<Arrivals>,
    /// Samples of the speed of the motor in the log, before any interpolation.
    pub motor: Arrivals,
    /// Samples of the board in the record.
    pub board: Arrivals,
    /// Inertial samples that are left out, because the speed of the motor is not known at their
    /// time.
    pub without_motor_speed: u64,
    /// Rows or messages that were not in the order of their times, and were sorted into it.
    pub sorted: u64,
    /// How regular the times are of the usable poses, the IMU and the motor; none of fewer than ten.
    pub times: [Option<Times>; 3],
    /// Whether the map has the rate of the exposures.
    pub exposures_are_known: bool,
    /// Ticks.
    pub ticks: u64,
}

impl Summary {
    /// Arrivals of samples at these times, which are in order.
    pub(super) fn arrivals(times_ns: impl Iterator<Item = u64>) -> Arrivals {
        let mut arrivals = Arrivals::default();
        for time_ns in times_ns {
            arrivals.add(Some(time_ns.cast_signed()));
        }
        arrivals
    }

    fn write_times(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut before = "; ";
        for (what, times) in ["poses", "IMU", "motor"].into_iter().zip(&self.times) {
            let Some(times) = times else { continue };
            let (rate, jitter) = (times.rate_hz, 1e3 * times.jitter_s);
            write!(
                formatter,
                "{before}{what} at {rate:.1} Hz, jitter {jitter:.2} ms"
            )?;
            if let Some(grid) = times.grid_s {
                write!(formatter, " on a grid of {:.2} ms", 1e3 * grid)?;
            }
            before = ", ";
        }
        if let [Some(poses), ..] = &self.times
            && let Some(rate) = poses.exposures_hz()
            && !self.exposures_are_known
        {
            write!(
                formatter,
                "; if the cameras expose regularly, set pose.exposures_hz = {rate} in the map"
            )?;
        }
        match self.sorted {
            0 => Ok(()),
            rows => write!(
                formatter,
                "; rows sorted into the order of their times: {rows}"
            ),
        }
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let duration_s = self.duration_ns as f64 * 1e-9;
        write!(formatter, "{duration_s:.2} s, {} poses", self.poses.count)?;
        for (count, what) in [
            (self.rejected, "not finite"),
            (self.untracked, "not tracked"),
        ] {
            if count > 0 {
                write!(formatter, " and {count} {what}")?;
            }
        }
        write!(formatter, ", {} board samples of ", self.board.count)?;
        if let Some(inertial) = &self.inertial {
            write!(formatter, "{} of the IMU and ", inertial.count)?;
        }
        write!(formatter, "{} of the motor", self.motor.count)?;
        if self.without_motor_speed > 0 {
            let count = self.without_motor_speed;
            write!(
                formatter,
                " ({count} of the IMU left out: no speed of the motor)"
            )?;
        }
        write!(formatter, ", {} ticks; largest gaps: ", self.ticks)?;
        write_gap(formatter, "poses", &self.poses)?;
        if let Some(inertial) = &self.inertial {
            write_gap(formatter, ", IMU", inertial)?;
        }
        write_gap(formatter, ", motor", &self.motor)?;
        write_gap(formatter, ", board samples", &self.board)?;
        self.write_times(formatter)
    }
}

fn write_gap(formatter: &mut fmt::Formatter<'_>, what: &str, of: &Arrivals) -> fmt::Result {
    match of.longest_gap() {
        None => write!(formatter, "{what} none"),
        Some(gap) => {
            let start_s = seconds_since(FIRST_ROW_NS, gap.begin_ns.cast_unsigned());
            let length_s = gap.longest_ns as f64 * 1e-9;
            write!(formatter, "{what} {length_s:.3} s at {start_s:.3} s")
        }
    }
}
