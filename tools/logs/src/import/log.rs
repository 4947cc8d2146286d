//! A foreign log: its samples, how regular their times are, why it is not imported, and a summary of an
//! import.

use std::{
    error::Error,
    fmt,
    path::{Path, PathBuf},
};

use singletrack_control::statistics::Arrivals;
use singletrack_mocap::Observation;
use singletrack_record::{RecordError, seconds_since};

use super::FIRST_ROW_NS;

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

/// Nanoseconds in a second.
const SECOND_NS: u64 = 1_000_000_000;

/// A sample of a sensor or of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample<const N: usize> {
    /// When it was measured, or in force from, on the clock of the record.
    pub(super) time_ns: u64,
    /// Its values.
    pub(super) values: [f64; N],
}

/// How samples are interpolated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Interpolation {
    /// Samples per second.
    pub(super) rate_hz: u32,
    /// Between samples that are farther apart there is nothing.
    pub(super) longest_gap_ns: u64,
}

/// Samples with the rule for the time between them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Series<const N: usize> {
    pub(super) samples: Vec<Sample<N>>,
    interpolation: Option<Interpolation>,
}

impl<const N: usize> Series<N> {
    /// Samples in the order of their times. Without an interpolation a value is held until the
    /// next one.
    pub(super) const fn new(samples: Vec<Sample<N>>, interpolation: Option<Interpolation>) -> Self {
        Self {
            samples,
            interpolation,
        }
    }

    /// The times of the samples of the log.
    pub(super) fn times_ns(&self) -> impl Iterator<Item = u64> {
        self.samples.iter().map(|sample| sample.time_ns)
    }

    /// The values at a time: of the last of several samples of that time. `None` before the first
    /// one, and where an interpolation has nothing.
    pub(super) fn at(&self, time_ns: u64) -> Option<[f64; N]> {
        let after = self.samples.partition_point(|one| one.time_ns <= time_ns);
        let before = self.samples.get(after.checked_sub(1)?)?;
        match self.interpolation {
            Some(interpolation) if before.time_ns != time_ns => {
                between(before, self.samples.get(after)?, time_ns, interpolation)
            }
            _ => Some(before.values),
        }
    }

    /// All samples, or those at the rate of the interpolation: at whole multiples of its period,
    /// of which the first row of the log is one.
    pub(super) fn resampled(&self) -> Vec<Sample<N>> {
        let Some(interpolation) = self.interpolation else {
            return self.samples.clone();
        };
        let rate = u64::from(interpolation.rate_hz.max(1));
        let first = self.samples.first().map_or(0, |sample| sample.time_ns);
        let last = self.samples.last().map_or(0, |sample| sample.time_ns);
        let number =
            |time_ns: u64| (u128::from(time_ns) * u128::from(rate)) / u128::from(SECOND_NS);
        let mut resampled = Vec::new();
        for point in number(first)..=number(last) {
            let time_ns = (point * u128::from(SECOND_NS) / u128::from(rate)) as u64;
            let values = self.at(time_ns);
            resampled.extend(values.map(|values| Sample { time_ns, values }));
        }
        resampled
    }
}

/// Linear between two samples, if they are not too far apart.
fn between<const N: usize>(
    before: &Sample<N>,
    after: &Sample<N>,
    time_ns: u64,
    interpolation: Interpolation,
) -> Option<[f64; N]> {
    let gap_ns = after.time_ns - before.time_ns;
    if gap_ns > interpolation.longest_gap_ns {
        return None;
    }
    let share = (time_ns - before.time_ns) as f64 / gap_ns as f64;
    let mut values = before.values;
    for (value, after) in values.iter_mut().zip(after.values) {
        *value += share * (after - *value);
    }
    Some(values)
}

/// The share of a message's jitter that moves the next exposure: the clocks of cameras and log drift.
pub(super) const FOLLOWED: f64 = 0.02;

/// The jitter from which exposures that are regular are worth the key, in s; and the share of a period
/// up to which the times can be those of regular exposures.
const WORTH: f64 = 2e-4;
const REGULAR: f64 = 0.3;
/// The finest grid of stamps that is told, and how well the stamps must lie on it, in s.
const FINEST: f64 = 5e-4;
const ON_GRID: f64 = 1.5e-4;

/// The rate of a source, and what is irregular in its times.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Times {
    /// Samples per second: one over the median of the intervals.
    pub rate_hz: f64,
    /// Root mean square of the times' distances from regular ones, in s.
    pub jitter_s: f64,
    /// The step of a grid on which all times lie, if it is coarse, in s.
    pub grid_s: Option<f64>,
}

impl Times {
    /// The statistics of times in order, in ns; none for fewer than ten.
    pub(super) fn of(times_ns: &[u64]) -> Option<Self> {
        let intervals = times_ns.windows(2).map(|pair| pair[1] - pair[0]);
        let intervals: Vec<f64> = intervals.map(|ns| ns as f64 * 1e-9).collect();
        if intervals.len() < 10 {
            return None;
        }
        let mut sorted = intervals.clone();
        sorted.sort_by(f64::total_cmp);
        let mean = mean_period(&intervals, &sorted)?;
        Some(Self {
            rate_hz: 1.0 / mean,
            jitter_s: jitter(&intervals, mean),
            grid_s: grid(&sorted),
        })
    }

    /// The rate of regular exposures that these times may be, if that is worth a key.
    pub fn exposures_hz(&self) -> Option<u32> {
        let rate = self.rate_hz.round();
        let is_whole = (self.rate_hz - rate).abs() < 0.01 * rate;
        let is_jitter = self.jitter_s > WORTH && self.jitter_s < REGULAR / self.rate_hz;
        (is_whole && is_jitter).then_some(rate as u32)
    }
}

/// The mean of the intervals that are about one period: a gap is none.
fn mean_period(intervals: &[f64], sorted: &[f64]) -> Option<f64> {
    let median = sorted.get(sorted.len() / 2).copied()?;
    let about = 0.4 * median..1.6 * median;
    let whole = intervals.iter().copied().filter(|it| about.contains(it));
    let whole: Vec<f64> = whole.collect();
    let mean = whole.iter().sum::<f64>() / whole.len() as f64;
    (mean > 0.0).then_some(mean)
}

/// Distances from regular times that follow the clock slowly, as the import's exposures do.
fn jitter(intervals: &[f64], period: f64) -> f64 {
    let (mut off, mut squares, mut count) = (0.0, 0.0, 0.0);
    for interval in intervals {
        let periods = (interval / period).round().max(1.0);
        off += interval - periods * period;
        if off.abs() > 0.5 * period {
            off = 0.0;
        }
        squares += off * off;
        count += 1.0;
        off -= FOLLOWED * off;
    }
    f64::sqrt(squares / f64::max(count, 1.0))
}

/// The step of which all intervals, in order of their lengths, are multiples, if they are few ones.
fn grid(intervals: &[f64]) -> Option<f64> {
    // The levels on which the intervals lie.
    let mut levels: Vec<(f64, usize)> = Vec::new();
    for interval in intervals {
        match levels.last_mut() {
            Some((level, count)) if interval - *level < 2.0 * ON_GRID => {
                *level += (interval - *level) / (*count as f64 + 1.0);
                *count += 1;
            }
            _ => levels.push((*interval, 1)),
        }
    }
    // Strays are none.
    levels.retain(|(_, count)| 100 * count > intervals.len());
    let steps = levels.windows(2).map(|pair| pair[1].0 - pair[0].0);
    let step = steps.min_by(f64::total_cmp)?;
    let lies = |level: f64| (level - (level / step).round() * step).abs() < 2.0 * ON_GRID;
    let covers = levels.iter().map(|(_, count)| count).sum::<usize>() * 100 > 95 * intervals.len();
    (step > FINEST && covers && levels.iter().all(|(level, _)| lies(*level))).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERPOLATION: Interpolation = Interpolation {
        rate_hz: 100,
        longest_gap_ns: 30_000_000,
    };

    fn series(samples: &[(u64, f64)], interpolation: Option<Interpolation>) -> Series<1> {
        let samples = samples.iter().map(|(time_ms, value)| Sample {
            time_ns: time_ms * 1_000_000,
            values: [*value],
        });
        Series::new(samples.collect(), interpolation)
    }

    fn resampled(samples: &[(u64, f64)]) -> Vec<(u64, f64)> {
        let points = series(samples, Some(INTERPOLATION)).resampled();
        let rounded = |value: f64| (value * 1e9).round() / 1e9;
        let point = |one: &Sample<1>| (one.time_ns / 1_000_000, rounded(one.values[0]));
        points.iter().map(point).collect()
    }

    #[test]
    fn between_samples_values_are_linear_on_whole_periods() {
        assert_eq!(
            resampled(&[(1_005, 1.0), (1_025, 3.0), (1_035, 0.0)]),
            [(1_010, 1.5), (1_020, 2.5), (1_030, 1.5)]
        );
    }

    #[test]
    fn the_values_of_samples_on_the_grid_are_kept() {
        assert_eq!(
            resampled(&[(1_000, 1.0), (1_010, 3.0), (1_020, 0.0)]),
            [(1_000, 1.0), (1_010, 3.0), (1_020, 0.0)]
        );
    }

    #[test]
    fn nothing_is_made_up_in_a_long_gap_before_the_first_or_after_the_last_sample() {
        assert_eq!(
            resampled(&[(1_005, 1.0), (1_015, 2.0), (1_046, 9.0), (1_056, 8.0)]),
            [(1_010, 1.5), (1_050, 8.6)]
        );
        let gap = series(&[(1_000, 1.0), (1_031, 2.0)], Some(INTERPOLATION));
        assert_eq!(gap.at(1_000_000_000), Some([1.0]));
        for time_ms in [999, 1_001, 1_030, 1_032] {
            assert_eq!(gap.at(time_ms * 1_000_000), None, "{time_ms}");
        }
    }

    #[test]
    fn of_two_samples_of_one_time_the_last_one_counts() {
        let samples = [(1_000, 1.0), (1_010, 2.0), (1_010, 4.0), (1_020, 6.0)];
        assert_eq!(
            resampled(&samples),
            [(1_000, 1.0), (1_010, 4.0), (1_020, 6.0)]
        );
        let series = series(&samples, Some(INTERPOLATION));
        assert_eq!(series.at(1_010_000_000), Some([4.0]));
        assert_eq!(series.at(1_015_000_000), Some([5.0]));
    }

    #[test]
    fn without_interpolation_samples_are_kept_and_held() {
        let held = series(&[(1_003, 1.0), (2_000, 2.0)], None);
        assert_eq!(held.resampled().len(), 2);
        assert_eq!(held.at(1_002_999_999), None);
        assert_eq!(held.at(1_999_999_999), Some([1.0]));
        assert_eq!(held.at(9_000_000_000), Some([2.0]));
    }

    #[test]
    fn no_samples_are_no_values() {
        for interpolation in [None, Some(INTERPOLATION)] {
            let none = series(&[], interpolation);
            assert_eq!(none.resampled(), []);
            assert_eq!(none.at(1_000_000_000), None);
        }
    }

    fn times(step: impl Fn(u32) -> f64) -> Times {
        let times: Vec<u64> = (0..500).map(|n| (1e9 * (1.0 + step(n))) as u64).collect();
        Times::of(&times).unwrap()
    }

    #[test]
    fn stamps_on_a_coarse_grid_are_told_and_their_exposures_proposed() {
        let on_grid = times(|n| (f64::from(n) * 0.01 * 360.0).round() / 360.0);
        assert!(
            (on_grid.grid_s.unwrap() * 360.0 - 1.0).abs() < 0.02,
            "{on_grid:?}"
        );
        assert_eq!(on_grid.exposures_hz(), Some(100));
    }

    #[test]
    fn regular_times_and_lost_samples_need_no_key() {
        let regular = times(|n| f64::from(n + n / 100 * 7) * 0.01);
        assert!(regular.jitter_s < 1e-6, "{regular:?}");
        assert_eq!((regular.exposures_hz(), regular.grid_s), (None, None));
        assert_eq!(Times::of(&[0, 1, 2]), None);
    }
}
