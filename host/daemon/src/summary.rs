//! The figures of a run: counts and times since the daemon started; and the percentiles of its durations,
//! in a fixed amount of memory, however long the daemon runs.

use std::path::PathBuf;

use hdrhistogram::Histogram;
use serde::Serialize;
use singletrack_core::LineCounters;
use singletrack_mocap::planar::PlanarCounters as MocapCounters;
use singletrack_pilot::{Event, Mode};
use singletrack_record::TickRecord;

use crate::{realtime::RealTimeStatus, socket::SetpointFigures};

/// The figures of a run at its end, and its record.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Counts and times.
    #[serde(flatten)]
    pub figures: Figures,
    /// What the system granted the control thread.
    pub realtime: RealTimeStatus,
    /// The file of the record; `None` if records are disabled.
    pub record: Option<PathBuf>,
    /// Why the record is incomplete.
    pub record_error: Option<String>,
}

/// Counts and times since the daemon started.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Control ticks done.
    pub ticks: u64,
    /// Ticks in the mode driving.
    pub driving_ticks: u64,
    /// Points of the control grid at which no tick ran.
    pub deadline_misses: u64,
    /// Time from a tick's deadline to its start, in µs.
    pub lateness_us: Percentiles,
    /// Time from the mid-exposure of a pose to the drive command that rests on it, in µs;
    /// without the ticks that had no new pose.
    pub capture_to_command_us: Percentiles,
    /// Duration of a tick, in µs.
    pub tick_duration_us: Percentiles,
    /// The serial line to the board.
    pub frames: Frames,
    /// The motion capture.
    pub mocap: MocapFigures,
    /// Data dropped because a ring or list was full.
    pub dropped: Dropped,
    /// Set-points of the clients of the control socket.
    pub setpoints: SetpointFigures,
}

/// Counts of the serial line to the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Frames {
    /// Frames for the board.
    pub sent: u64,
    /// Valid frames from the board.
    pub received: u64,
    /// Frames with a wrong checksum.
    pub crc_errors: u64,
    /// Frames with other damage.
    pub decode_errors: u64,
    /// Drive commands written to the port.
    pub drives_written: u64,
    /// Drive commands not written because the port was full or closed, or the board silent.
    pub drives_withheld: u64,
    /// Telemetry records of the board that did not reach the host.
    pub telemetry_missing: u64,
    /// Times that the link was lost because the board was silent.
    pub links_lost: u64,
    /// Times that the port hung up.
    pub hang_ups: u64,
    /// Times that the board restarted.
    pub board_restarts: u64,
    /// Requests that the board did not answer.
    pub requests_unanswered: u64,
}

/// Counts of the motion capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MocapFigures {
    /// Frames received in order.
    pub frames: u64,
    /// Frames missing between two received ones.
    pub lost: u64,
    /// Driving ticks without an accepted pose since the last tick.
    pub held_ticks: u64,
    /// Frames without a valid pose during driving ticks.
    pub missing_while_driving: u64,
    /// Frames with a valid pose.
    pub valid: u64,
    /// Frames with the rigid body not tracked.
    pub untracked: u64,
    /// Frames without the rigid body.
    pub absent: u64,
    /// Frames with an implausible pose.
    pub rejected: u64,
    /// Frames older than the newest.
    pub late: u64,
    /// Frames received twice.
    pub duplicates: u64,
    /// Datagrams that do not decode.
    pub malformed: u64,
    /// Datagrams from another address.
    pub wrong_source: u64,
    /// Frames that contradict the stream: two senders use the server's address.
    pub contradictions: u64,
    /// Times that the stream stopped.
    pub stale: u64,
    /// Times that the session restarted.
    pub restarts: u64,
}

/// Counts of dropped data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Dropped {
    /// Events beyond the limit of a tick.
    pub events: u64,
    /// Observations of the cameras for the control thread; known at the end.
    pub observations: u64,
    /// Bytes from the serial line for the control thread; known at the end.
    pub serial_bytes: u64,
    /// Reports of the control thread to the collector.
    pub reports: u64,
    /// Entries missing in the record.
    pub record_entries: u64,
}

/// Accumulates [`Figures`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Tally {
    /// Without percentiles.
    pub(crate) figures: Figures,
    lateness: DurationHistogram,
    latency: DurationHistogram,
    duration: DurationHistogram,
}

impl Tally {
    pub(crate) fn tick(&mut self, tick: &TickRecord) {
        let figures = &mut self.figures;
        figures.ticks += 1;
        figures.deadline_misses += u64::from(tick.skipped);
        figures.dropped.events += u64::from(tick.events_dropped);
        self.lateness
            .add(u64::try_from(tick.lateness_ns()).unwrap_or(0));
        self.duration
            .add(tick.finish_ns.saturating_sub(tick.start_ns));
        if tick.output.mode == Mode::Driving {
            figures.driving_ticks += 1;
            figures.mocap.held_ticks += u64::from(tick.output.held);
            let missing = tick.events.iter();
            figures.mocap.missing_while_driving += missing
                .filter(|event| matches!(event, Event::PoseMissing(_)))
                .count() as u64;
        }
        if !tick.output.held
            && let Some(latency) = tick.capture_to_command_ns()
        {
            self.latency.add(u64::try_from(latency).unwrap_or(0));
        }
    }

    pub(crate) fn line(&mut self, counters: &LineCounters) {
        let link = &counters.link;
        self.figures.dropped.reports = counters.reports_dropped;
        self.figures.frames = Frames {
            sent: link.frames_sent,
            received: link.frames_received,
            crc_errors: link.crc_errors,
            decode_errors: link.decode_errors,
            drives_written: counters.drives_written,
            drives_withheld: counters.drives_withheld,
            telemetry_missing: link.telemetry_missing,
            links_lost: link.links_lost,
            hang_ups: link.hang_ups,
            board_restarts: link.board_restarts,
            requests_unanswered: link.requests_unanswered,
        };
    }

    pub(crate) fn mocap(&mut self, counters: &MocapCounters) {
        let session = &counters.session;
        self.figures.mocap = MocapFigures {
            frames: session.frames,
            lost: session.lost,
            held_ticks: self.figures.mocap.held_ticks,
            missing_while_driving: self.figures.mocap.missing_while_driving,
            valid: counters.valid,
            untracked: counters.untracked,
            absent: counters.absent,
            rejected: counters.rejected.total(),
            late: session.late,
            duplicates: session.duplicates,
            malformed: session.malformed,
            wrong_source: session.wrong_source,
            contradictions: session.contradictions,
            stale: session.stale,
            restarts: session.restarts,
        };
    }

    /// All figures so far.
    pub(crate) fn figures(&self) -> Figures {
        Figures {
            lateness_us: self.lateness.percentiles(),
            capture_to_command_us: self.latency.percentiles(),
            tick_duration_us: self.duration.percentiles(),
            ..self.figures.clone()
        }
    }
}

/// Significant decimal digits of the buckets: each is at most 1 % wide.
const DIGITS: u8 = 2;

/// The longest duration with a bucket of its own size, in ns: 292 years.
const LONGEST_NS: u64 = i64::MAX as u64;

/// Percentiles of durations, in microseconds; zeros without durations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Half of the values are at most this; rounded up by at most 1 %.
    pub p50: f64,
    /// 99 % of the values are at most this; rounded up by at most 1 %.
    pub p99: f64,
    /// The largest value, exactly.
    pub max: f64,
}

/// A histogram of durations in nanoseconds, in buckets of at most 1 %. It allocates
/// about 60 kB when it is made and nothing afterwards.
#[derive(Clone, Debug)]
struct DurationHistogram {
    buckets: Histogram<u64>,
    /// The bucket of the largest value only bounds it.
    max_ns: u64,
}

impl Default for DurationHistogram {
    #[expect(clippy::expect_used, reason = "the arguments are constants and valid")]
    fn default() -> Self {
        Self {
            buckets: Histogram::new_with_max(LONGEST_NS, DIGITS).expect("valid arguments"),
            max_ns: 0,
        }
    }
}

impl DurationHistogram {
    /// Adds a duration, in ns.
    fn add(&mut self, ns: u64) {
        self.buckets.saturating_record(ns);
        self.max_ns = self.max_ns.max(ns);
    }

    /// The percentiles of all durations so far.
    fn percentiles(&self) -> Percentiles {
        let microseconds = |ns: u64| ns as f64 / 1_000.0;
        Percentiles {
            p50: microseconds(self.quantile_ns(0.5)),
            p99: microseconds(self.quantile_ns(0.99)),
            max: microseconds(self.max_ns),
        }
    }

    fn quantile_ns(&self, part: f64) -> u64 {
        // The end of a bucket, which may lie beyond every value in it.
        self.buckets.value_at_quantile(part).min(self.max_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_lies_in_its_bucket_and_buckets_are_narrow() {
        for ns in (0..63).flat_map(|bits| {
            let power = 1_u64 << bits;
            [power - 1, power, power + power / 3, power + (power - 1)]
        }) {
            let mut histogram = DurationHistogram::default();
            histogram.add(ns);
            let end = histogram.buckets.value_at_quantile(0.5);
            assert!(end >= ns, "{ns}");
            assert!((end - ns) as f64 <= 0.01 * ns as f64, "{ns}");
            assert_eq!(histogram.quantile_ns(0.5), ns);
        }
    }

    #[test]
    fn longer_durations_saturate_and_the_largest_stays_exact() {
        let mut histogram = DurationHistogram::default();
        histogram.add(u64::MAX);
        let Percentiles { p50, p99, max } = histogram.percentiles();
        assert_eq!(p50, p99);
        assert!(p50 >= LONGEST_NS as f64 / 1_000.0, "{p50}");
        assert_eq!(max, u64::MAX as f64 / 1_000.0);
    }

    #[test]
    fn percentiles_are_those_of_the_values() {
        let mut histogram = DurationHistogram::default();
        assert_eq!(histogram.percentiles(), Percentiles::default());
        for us in 1..=1_000_u64 {
            histogram.add(us * 1_000);
        }
        let Percentiles { p50, p99, max } = histogram.percentiles();
        assert!((500.0..505.0).contains(&p50), "{p50}");
        assert!((990.0..=1_000.0).contains(&p99), "{p99}");
        assert_eq!(max, 1_000.0);
    }
}
