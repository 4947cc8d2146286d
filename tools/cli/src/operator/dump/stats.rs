//! Statistics, also as a page for a person: rates, gaps, losses, errors, latencies, modes.

use std::collections::BTreeMap;

use serde::Serialize;
use singletrack_control::statistics::{Arrivals, Distribution, Gap};
use singletrack_mocap::{Observation, PoseState};
use singletrack_pilot::Reason;
use singletrack_protocol::{
    RefusalReason, Status, StopCause, TELEMETRY_PERIOD_US, Telemetry, ToHost,
};
use singletrack_record::{Entry, TickRecord};

use super::source::{About, Kind, Message, Row};
use crate::Result;

/// All statistics. Values that the source does not have are null or empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct Report {
    /// The source.
    pub(super) source: String,
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
    pub(super) lateness_us: Option<Durations>,
    /// From mid-exposure to the command leaving, in ticks with a new pose.
    pub(super) capture_to_command_us: Option<Durations>,
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
    /// Telemetry records that came.
    #[serde(skip)]
    pub(super) telemetry: u64,
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
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(super) struct BoardCounters {
    pub(super) frames_received: u64,
    pub(super) frames_damaged: u64,
    pub(super) drives_refused: u64,
    pub(super) frames_dropped: u64,
    pub(super) bytes_overrun: u64,
    pub(super) imu_errors: u64,
    /// Why a drive command was last refused.
    pub(super) last_refusal: Option<&'static str>,
}

/// Poses of the motion capture.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
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
    pub(super) mode: &'static str,
    pub(super) reason: Option<&'static str>,
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
    /// The distribution of durations in microseconds; none if there are none.
    fn of(durations_us: &[f64]) -> Option<Self> {
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
/// is not empty.
fn histogram(durations: &Distribution) -> Vec<Bucket> {
    let ends = (0..=15).flat_map(|decade| [1, 2, 5].map(|step| step * 10_i64.pow(decade)));
    let mut before = 0;
    let buckets = [0].into_iter().chain(ends).map_while(|end_us| {
        let up_to = end_us as f64;
        let count = durations.count_up_to(up_to) - before;
        let has_more = before < durations.count();
        before += count;
        has_more.then_some(Bucket {
            up_to,
            count: count as u64,
        })
    });
    buckets.skip_while(|bucket| bucket.count == 0).collect()
}

/// When a mode and its reason began, in ns.
type Change = (i64, (&'static str, Option<&'static str>));

/// Counts the rows of the chosen kinds.
#[derive(Default)]
pub(super) struct Stats<'a> {
    /// The arrivals of each kind.
    arrivals: Vec<(&'a Kind, Arrivals)>,
    /// The first and the last time.
    span_ns: Option<[i64; 2]>,
    /// When the last telemetry came, and the board's clock in it.
    telemetry: Option<(i64, u32)>,
    telemetry_gap: Gap,
    status: Option<Status>,
    frame_number: Option<i32>,
    valid: Arrivals,
    modes: Vec<Change>,
    board_modes: Vec<Change>,
    /// In us, as all that is reported of them.
    lateness_us: Vec<f64>,
    capture_to_command_us: Vec<f64>,
    report: Report,
}

impl<'a> Stats<'a> {
    pub(super) fn new(kinds: &'a [Kind]) -> Self {
        let arrivals = kinds.iter().map(|kind| (kind, Arrivals::default()));
        Self {
            arrivals: arrivals.collect(),
            ..Self::default()
        }
    }

    /// Counts a row.
    pub(super) fn add(&mut self, row: Row<'_>) -> Result<()> {
        if let Some(time_ns) = row.time_ns {
            let [first_ns, last_ns] = self.span_ns.unwrap_or([time_ns; 2]);
            self.span_ns = Some([first_ns.min(time_ns), last_ns.max(time_ns)]);
        }
        if let Some((_, arrivals)) = self.arrivals.get_mut(row.kind) {
            arrivals.add(row.time_ns);
        }
        let time_ns = row.time_ns.unwrap_or_default();
        match row.message {
            Message::Recorded(reader) => {
                reader.read_entry(|entry| self.add_entry(time_ns, entry))?;
            }
            Message::Entry(entry) => self.add_entry(time_ns, &entry),
            Message::Frame(frame) => match frame.message {
                Ok(ToHost::Telemetry(telemetry)) => self.add_telemetry(time_ns, &telemetry),
                Ok(ToHost::Status(status)) => self.add_status(&status),
                Ok(_) => {}
                Err(reason) => count(&mut self.report.line.broken, reason.to_owned()),
            },
        }
        Ok(())
    }

    /// Counts an entry; a tick of a record is without its events.
    fn add_entry(&mut self, time_ns: i64, entry: &Entry) {
        match entry {
            Entry::Tick(tick) => self.add_tick(time_ns, tick),
            Entry::Telemetry(record) => self.add_telemetry(time_ns, &record.telemetry),
            Entry::Status(record) => self.add_status(&record.status),
            Entry::Pose(observation) => self.add_pose(time_ns, observation),
            // The count since the record began.
            Entry::Drops(drops) => {
                let dropped = &mut self.report.entries_dropped;
                *dropped = drops.entries.max(*dropped);
            }
            Entry::Log(_) | Entry::Configuration(_) => {}
        }
    }

    fn add_tick(&mut self, time_ns: i64, tick: &TickRecord) {
        let output = &tick.output;
        let counts = self.report.ticks.get_or_insert_default();
        counts.skipped += u64::from(tick.skipped);
        counts.events_dropped += u64::from(tick.events_dropped);
        counts.without_new_pose += u64::from(output.held);
        counts.commands_not_written += u64::from(tick.drive.is_some_and(|drive| !drive.written));
        self.lateness_us.push(tick.lateness_ns() as f64 / 1e3);
        // In a held tick the pose is an old one, which says nothing of the latency.
        let latency_ns = tick.capture_to_command_ns().filter(|_| !output.held);
        let latency_us = latency_ns.map(|ns| ns as f64 / 1e3);
        self.capture_to_command_us.extend(latency_us);
        let reason = output.reason.map(Reason::name);
        enter(&mut self.modes, (time_ns, (output.mode.name(), reason)));
    }

    /// Counts lost telemetry, by the board's clock.
    fn add_telemetry(&mut self, time_ns: i64, telemetry: &Telemetry) {
        let board_us = telemetry.board_time_us;
        let line = &mut self.report.line;
        line.telemetry += 1;
        if let Some((last_ns, last_us)) = self.telemetry.replace((time_ns, board_us)) {
            let passed_us = board_us.wrapping_sub(last_us);
            // Rounded: a record may be up to half a period early or late.
            let periods = passed_us.saturating_add(TELEMETRY_PERIOD_US / 2) / TELEMETRY_PERIOD_US;
            let lost = periods.saturating_sub(1);
            if passed_us.cast_signed() < 0 {
                line.board_restarts += 1;
            } else if lost > 0 {
                line.telemetry_lost += u64::from(lost);
                line.gaps += 1;
                let gap = &mut self.telemetry_gap;
                gap.add(last_ns, last_ns + i64::from(passed_us) * 1_000);
                [line.longest_gap_ms, line.longest_gap_at_s] = figures(Some(*gap));
            }
        }
        let cause = telemetry.stop_cause;
        let reason = (cause != StopCause::None).then(|| cause.name());
        let mode = telemetry.mode.name();
        enter(&mut self.board_modes, (time_ns, (mode, reason)));
    }

    /// Counts what the board has counted.
    fn add_status(&mut self, status: &Status) {
        // Counts before the record began do not belong to it.
        let last = self.status.replace(*status).unwrap_or(*status);
        let passed_us = status.board_time_us.wrapping_sub(last.board_time_us);
        let has_restarted = passed_us.cast_signed() < 0;
        // The counters wrap, and start at zero when the board restarts.
        let rise = |count: fn(&Status) -> u16| {
            let before = if has_restarted { 0 } else { count(&last) };
            u64::from(count(status).wrapping_sub(before))
        };
        let board = self.report.board.get_or_insert_default();
        board.frames_received += rise(|status| status.frames_received);
        board.frames_damaged += rise(|status| status.frames_damaged);
        board.drives_refused += rise(|status| status.drives_refused);
        board.frames_dropped += rise(|status| status.frames_dropped);
        board.bytes_overrun += rise(|status| status.bytes_overrun);
        board.imu_errors += rise(|status| status.imu_errors);
        let refusal = status.last_refusal;
        board.last_refusal = (refusal != RefusalReason::None).then(|| refusal.name());
    }

    fn add_pose(&mut self, time_ns: i64, observation: &Observation) {
        let report = self.report.poses.get_or_insert_default();
        let number = observation.frame_number;
        if let Some(last) = self.frame_number.replace(number) {
            // Numbers that go back belong to another stream.
            let missing = i64::from(number) - i64::from(last) - 1;
            report.frames_missing += u64::try_from(missing).unwrap_or_default();
        }
        let (state, why) = match observation.state {
            PoseState::NoFrames => ("no-frames", None),
            PoseState::Unbound(_) => ("unbound", None),
            PoseState::Valid(_) => ("valid", None),
            PoseState::Untracked => ("untracked", None),
            PoseState::Absent => ("absent", None),
            PoseState::Rejected(why) => ("rejected", Some(why)),
            PoseState::LockedOut(why) => ("locked-out", Some(why)),
            PoseState::Stale { .. } => ("stale", None),
        };
        let why = why.map_or_else(String::new, |why| format!(": {}", why.name()));
        count(&mut report.states, format!("{state}{why}"));
        if let PoseState::Valid(_) = observation.state {
            self.valid.add(Some(time_ns));
            let gap = self.valid.longest_gap().filter(|gap| gap.longest_ns > 0);
            [
                report.longest_between_valid_ms,
                report.longest_between_valid_at_s,
            ] = figures(gap);
        }
    }

    /// All that has been counted.
    pub(super) fn report(&self, name: &str, source: &About) -> Report {
        let [first_ns, last_ns] = self.span_ns.unwrap_or_default();
        let span_s = seconds(last_ns - first_ns);
        let mut report = Report {
            source: name.to_owned(),
            unfinished: source.is_unfinished,
            missed: source.missed,
            span_s,
            lateness_us: Durations::of(&self.lateness_us),
            capture_to_command_us: Durations::of(&self.capture_to_command_us),
            modes: spans(&self.modes, last_ns),
            board_modes: spans(&self.board_modes, last_ns),
            ..self.report.clone()
        };
        for (kind, arrivals) in self.arrivals.iter().filter(|(kind, _)| kind.chosen) {
            let [longest_gap_ms, longest_gap_at_s] = figures(arrivals.longest_gap());
            report.topics.push(TopicReport {
                topic: kind.name,
                count: arrivals.count,
                rate_hz: arrivals.rate_hz(),
                first_s: arrivals.first_ns().map(seconds),
                last_s: arrivals.last_ns().map(seconds),
                longest_gap_ms,
                longest_gap_at_s,
            });
        }
        report.line.bytes = source.line_bytes;
        let rate = |bytes: u64| (span_s > 0.0).then(|| bytes as f64 / span_s);
        report.line.bytes_per_s = report.line.bytes.and_then(rate);
        report
    }
}

/// Adds a change unless the last one has the same mode and reason.
fn enter(changes: &mut Vec<Change>, change: Change) {
    if changes.last().is_none_or(|last| last.1 != change.1) {
        changes.push(change);
    }
}

/// The modes between the changes, of which the last one ends at `end_ns`.
fn spans(changes: &[Change], end_ns: i64) -> Vec<ModeSpan> {
    let ends = changes.iter().skip(1).map(|(begin_ns, _)| *begin_ns);
    let spans = changes.iter().zip(ends.chain([end_ns]));
    let span = |((begin_ns, (mode, reason)), end_ns): (&Change, i64)| ModeSpan {
        mode,
        reason: *reason,
        from_s: seconds(*begin_ns),
        duration_s: seconds(end_ns - begin_ns),
    };
    spans.map(span).collect()
}

/// The length of a gap in ms, and when it began, in s.
fn figures(gap: Option<Gap>) -> [Option<f64>; 2] {
    [
        gap.map(|gap| gap.longest_ns as f64 / 1e6),
        gap.map(|gap| seconds(gap.begin_ns)),
    ]
}

fn count(counts: &mut BTreeMap<String, u64>, what: String) {
    *counts.entry(what).or_default() += 1;
}

fn seconds(ns: i64) -> f64 {
    ns as f64 / 1e9
}

/// The longest bar of a histogram, in characters.
const BAR: u64 = 50;
/// No more spans of modes than this are listed one by one.
const MAX_SPANS: usize = 40;

/// What a summary does not show.
const MORE: &str = "--stats adds latencies, --topic tick prints rows, --help has examples";

impl Report {
    /// It as a page for a person; a `brief` one leaves out the distributions.
    pub(super) fn page(&self, brief: bool) -> String {
        let unfinished = if self.unfinished { ", unfinished" } else { "" };
        let mut page = format!("{}: {:.3} s{unfinished}", self.source, self.span_s);
        page += &self.topics();
        page += &self.counts();
        if !brief {
            page += &distribution("lateness of ticks, in us", self.lateness_us.as_ref());
            let title = "from mid-exposure to the command leaving, in us (ticks with a new pose)";
            page += &distribution(title, self.capture_to_command_us.as_ref());
        }
        page += &modes("modes", &self.modes);
        page += &modes("modes of the board", &self.board_modes);
        if brief {
            page += &format!("\n\n{MORE}");
        }
        page
    }

    fn topics(&self) -> String {
        let header = "topic               count     per s     first s      last s  longest gap ms        at s";
        let mut table = format!("\n\n{header}");
        for topic in &self.topics {
            table += &format!("\n{:<16}{:>9}", topic.topic, topic.count);
            for (value, width, digits) in [
                (topic.rate_hz, 10, 2),
                (topic.first_s, 12, 3),
                (topic.last_s, 12, 3),
                (topic.longest_gap_ms, 16, 3),
                (topic.longest_gap_at_s, 12, 3),
            ] {
                let value = value.map_or("-".to_owned(), |value| format!("{value:.digits$}"));
                table += &format!("{value:>width$}");
            }
        }
        table
    }

    /// What was counted on the line, by the board, of poses and ticks, and in the record.
    fn counts(&self) -> String {
        let line = &self.line;
        let mut text = String::new();
        if line.telemetry > 0 {
            let (lost, gaps, restarts) = (line.telemetry_lost, line.gaps, line.board_restarts);
            let all = lost + line.telemetry;
            text += &format!("\n\ntelemetry lost on the line: {lost} of {all}");
            if let Some((ms, at_s)) = line.longest_gap_ms.zip(line.longest_gap_at_s) {
                text += &format!(" (in {gaps} gaps, the longest {ms:.1} ms at {at_s:.3} s)");
            }
            if restarts > 0 {
                text += &format!("; the board restarted {restarts} times");
            }
        }
        if let Some(bytes) = line.bytes {
            let rate = line.bytes_per_s.map(|rate| format!(", {rate:.0} per s"));
            let (rate, broken) = (rate.unwrap_or_default(), counts(&line.broken));
            text += &format!("\nbytes on the line: {bytes}{rate}\nbroken frames: {broken}");
        }
        if let Some(board) = &self.board {
            text += &format!(
                "\nthe board counted: {} frames received, {} frames damaged, {} drives refused, \
                 {} frames dropped, {} bytes overrun, {} imu errors",
                board.frames_received,
                board.frames_damaged,
                board.drives_refused,
                board.frames_dropped,
                board.bytes_overrun,
                board.imu_errors
            );
            if let Some(refusal) = board.last_refusal.filter(|_| board.drives_refused > 0) {
                text += &format!(" (the last refusal: {refusal})");
            }
        }
        if let Some(poses) = &self.poses {
            let (states, missing) = (counts(&poses.states), poses.frames_missing);
            text += &format!("\nposes: {states}; {missing} frames missing");
            let longest = poses.longest_between_valid_ms;
            if let Some((ms, at_s)) = longest.zip(poses.longest_between_valid_at_s) {
                text += &format!("; at most {ms:.1} ms between valid ones, at {at_s:.3} s");
            }
        }
        if let Some(ticks) = &self.ticks {
            text += &format!(
                "\nticks: {} skipped, {} events dropped, {} without a new pose, {} commands not written",
                ticks.skipped,
                ticks.events_dropped,
                ticks.without_new_pose,
                ticks.commands_not_written
            );
        }
        let (dropped, missed) = (self.entries_dropped, self.missed);
        if self.ticks.is_some() || dropped > 0 {
            text += &format!("\nentries that did not reach the record: {dropped}");
        }
        if missed > 0 {
            let why = "because they came faster than they were taken";
            text += &format!("\nmissed, {why}: {missed}");
        }
        text
    }
}

fn counts(counts: &BTreeMap<String, u64>) -> String {
    let counts = counts.iter().map(|(what, count)| format!("{count} {what}"));
    match counts.collect::<Vec<_>>().as_slice() {
        [] => "none".to_owned(),
        counts => counts.join(", "),
    }
}

fn distribution(title: &str, durations: Option<&Durations>) -> String {
    let Some(of) = durations else {
        return String::new();
    };
    let mut text = format!(
        "\n\n{title}\n  min {:.1} p50 {:.1} p90 {:.1} p99 {:.1} p99.9 {:.1} max {:.1}",
        of.min, of.p50, of.p90, of.p99, of.p999, of.max
    );
    let most = of.histogram.iter().map(|bucket| bucket.count).max();
    for bucket in &of.histogram {
        // Every bucket that is not empty has a bar.
        let bar = (bucket.count * BAR).div_ceil(most.unwrap_or(1).max(1));
        let bar = "#".repeat(bar as usize);
        let line = format!("  up to {:>9} {:>9}  {bar}", bucket.up_to, bucket.count);
        text += &format!("\n{}", line.trim_end());
    }
    text
}

fn modes(title: &str, spans: &[ModeSpan]) -> String {
    if spans.is_empty() {
        return String::new();
    }
    let mut table = format!("\n\n{title:<20}      from s       for s  why");
    for span in spans.iter().take(MAX_SPANS) {
        let (mode, why) = (span.mode, span.reason.unwrap_or("-"));
        let (from_s, for_s) = (span.from_s, span.duration_s);
        table += &format!("\n  {mode:<18}{from_s:>12.3}{for_s:>12.3}  {why}");
    }
    if spans.len() > MAX_SPANS {
        let more = spans.len() - MAX_SPANS;
        table += &format!("\n  and {more} more: --format json has them all");
    }
    table
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
