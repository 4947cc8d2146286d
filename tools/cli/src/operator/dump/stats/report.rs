//! The statistics for a program; `table` prints them for a person.

use std::collections::BTreeMap;

use serde::{Serialize, Serializer, ser::SerializeMap};
use singletrack_statistics::Distribution;

/// All statistics. Values that the source does not have are null or empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(in crate::operator::dump) struct Report {
    /// The source.
    pub(super) source: String,
    /// Whether the page leaves out the distributions.
    #[serde(skip)]
    pub(super) brief: bool,
    /// Whether it is a record that has not been finished.
    pub(super) unfinished: bool,
    /// Rows that arrived faster than they were read, and are not counted.
    pub(super) missed: u64,
    /// From the first row to the last.
    pub(super) span_s: f64,
    /// How often each topic came.
    pub(super) topics: Vec<TopicReport>,
    /// The line from the board to the host.
    pub(super) line: LineReport,
    /// The board's counters.
    pub(super) board: Option<BoardCounters>,
    /// Poses of the motion capture.
    pub(super) poses: Option<PoseReport>,
    /// Ticks of the control thread.
    pub(super) ticks: Option<TickReport>,
    /// Entries that did not reach the record.
    pub(super) entries_dropped: u64,
    /// How late ticks began.
    #[serde(rename = "lateness_us")]
    pub(super) lateness: Option<Durations>,
    /// From mid-exposure to the command leaving, in ticks with a new pose.
    #[serde(rename = "capture_to_command_us")]
    pub(super) capture_to_command: Option<Durations>,
    /// The pilot's modes.
    pub(super) modes: Vec<ModeSpan>,
    /// The modes of the board's safety machine.
    pub(super) board_modes: Vec<ModeSpan>,
}

/// How often a topic came.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct TopicReport {
    pub(super) topic: &'static str,
    pub(super) count: u64,
    pub(super) rate_hz: Option<f64>,
    pub(super) first_s: Option<f64>,
    pub(super) last_s: Option<f64>,
    pub(super) longest_gap_ms: Option<f64>,
    /// When the longest gap began.
    pub(super) longest_gap_at_s: Option<f64>,
}

/// Frames on the line.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct LineReport {
    /// Whether there was telemetry.
    #[serde(skip)]
    pub(super) telemetry: bool,
    /// Telemetry records that the board's clock misses.
    pub(super) telemetry_lost: u64,
    /// In how many gaps.
    pub(super) gaps: u64,
    pub(super) longest_gap_ms: Option<f64>,
    pub(super) longest_gap_at_s: Option<f64>,
    pub(super) board_restarts: u64,
    /// Bytes that are not a frame, by reason.
    pub(super) broken: BTreeMap<String, u64>,
    pub(super) bytes: Option<u64>,
    pub(super) bytes_per_s: Option<f64>,
}

/// The board's counters, by how much they rose.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct BoardCounters {
    /// In the order of [`Self::NAMES`].
    pub(super) counts: [u64; Self::NAMES.len()],
    /// Why a drive command was last refused.
    pub(super) last_refusal: Option<String>,
}

impl BoardCounters {
    /// The fields of a status record that count.
    pub(super) const NAMES: [&str; 6] = [
        "frames_received",
        "frames_damaged",
        "drives_refused",
        "frames_dropped",
        "bytes_overrun",
        "imu_errors",
    ];

    /// By how much one of them rose.
    pub(super) fn count(&self, name: &str) -> u64 {
        Self::NAMES
            .iter()
            .zip(self.counts)
            .find_map(|(known, count)| (*known == name).then_some(count))
            .unwrap_or_default()
    }
}

impl Serialize for BoardCounters {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for (name, count) in Self::NAMES.iter().zip(self.counts) {
            map.serialize_entry(name, &count)?;
        }
        map.serialize_entry("last_refusal", &self.last_refusal)?;
        map.end()
    }
}

/// Poses of the motion capture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct PoseReport {
    /// Frames by the state of the car in them.
    pub(super) states: BTreeMap<String, u64>,
    /// Frame numbers that never arrived.
    pub(super) frames_missing: u64,
    /// The longest time between two valid poses, if there are two.
    pub(super) longest_between_valid_ms: Option<f64>,
    pub(super) longest_between_valid_at_s: Option<f64>,
}

/// Ticks of the control thread.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct TickReport {
    /// Points of the grid without a tick: the one before took too long.
    pub(super) skipped: u64,
    /// Events that the pilot never saw.
    pub(super) events_dropped: u64,
    /// Ticks without a new valid pose.
    pub(super) without_new_pose: u64,
    /// Commands that the line had no room for.
    pub(super) commands_not_written: u64,
}

/// For how long a mode lasted, and why it was.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct ModeSpan {
    pub(super) mode: String,
    pub(super) reason: Option<String>,
    pub(super) from_s: f64,
    pub(super) duration_s: f64,
}

/// How durations are distributed, in microseconds. Every percentile is one of
/// the durations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Durations {
    pub(super) count: u64,
    pub(super) min: f64,
    pub(super) p50: f64,
    pub(super) p90: f64,
    pub(super) p99: f64,
    #[serde(rename = "p99.9")]
    pub(super) p999: f64,
    pub(super) max: f64,
    pub(super) histogram: Vec<Bucket>,
}

/// Durations of about the same length.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Bucket {
    /// More than the bucket before, and at most this.
    pub(super) up_to: f64,
    pub(super) count: u64,
}

impl Durations {
    /// Of durations in microseconds; none if there are none.
    pub(super) fn of(durations_us: &[f64]) -> Option<Self> {
        let durations = Distribution::of(durations_us.iter().copied());
        Some(Self {
            count: durations.count() as u64,
            min: durations.min()?,
            p50: durations.quantile(0.5)?,
            p90: durations.quantile(0.9)?,
            p99: durations.quantile(0.99)?,
            p999: durations.quantile(0.999)?,
            max: durations.max()?,
            histogram: histogram(&durations),
        })
    }
}

/// Buckets that end at 1, 2, 5, 10, 20, ... us, from the first to the last that
/// something is in.
fn histogram(durations: &Distribution) -> Vec<Bucket> {
    let ends = (0..=15).flat_map(|decade| [1, 2, 5].map(|step| step * 10_i64.pow(decade)));
    let mut buckets = Vec::new();
    let mut before = 0;
    for end_us in [0].into_iter().chain(ends) {
        if before == durations.count() {
            break;
        }
        let up_to = end_us as f64;
        let count = durations.count_up_to(up_to) - before;
        if count > 0 || !buckets.is_empty() {
            buckets.push(Bucket {
                up_to,
                count: count as u64,
            });
        }
        before += count;
    }
    buckets
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_durations_that_occurred() {
        let durations: Vec<f64> = (1..=1_000).rev().map(f64::from).collect();
        let distribution = Durations::of(&durations).unwrap();
        assert_eq!(
            [
                distribution.min,
                distribution.p50,
                distribution.p90,
                distribution.p99,
                distribution.p999,
                distribution.max
            ],
            [1.0, 500.0, 900.0, 990.0, 999.0, 1_000.0]
        );
        assert_eq!(Durations::of(&[]), None);
        assert_eq!(Durations::of(&[-0.007]).unwrap().p999, -0.007);
    }

    #[test]
    fn every_duration_is_in_one_bucket() {
        let durations = [-5, 0, 1, 1_000, 1_001, 2_000, 40_000, i64::MAX];
        let durations = durations.map(|ns| ns as f64 / 1e3);
        let buckets = histogram(&Distribution::of(durations));
        let shown: Vec<_> = buckets
            .iter()
            .filter(|bucket| bucket.count > 0)
            .map(|bucket| (bucket.up_to, bucket.count))
            .collect();
        assert_eq!(shown[..4], [(0.0, 2), (1.0, 2), (2.0, 2), (50.0, 1)]);
        assert_eq!(
            buckets.iter().map(|bucket| bucket.count).sum::<u64>(),
            durations.len() as u64 - u64::from(i64::MAX as f64 / 1e3 > 5e15)
        );
    }
}
