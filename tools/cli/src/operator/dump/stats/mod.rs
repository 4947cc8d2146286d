//! Statistics: rates, gaps, losses, errors, latencies, modes.

mod report;
mod table;

use std::collections::BTreeMap;

use singletrack_protocol::TELEMETRY_PERIOD_US;
use singletrack_record::{Topic, Value};
use singletrack_statistics::{Arrivals, Gap};

use super::{
    kind::Kind,
    source::{BROKEN, Close, Row},
};
use report::{BoardCounters, Durations, ModeSpan, PoseReport, Report, TickReport, TopicReport};

/// Counts rows.
pub(super) struct Stats {
    /// The name of each kind, and its arrivals if it is counted.
    topics: Vec<Option<(&'static str, Arrivals)>>,
    counters: Vec<Counter>,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
    brief: bool,
}

/// What is counted of a kind besides its rate, and of which fields.
enum Counter {
    Ticks(Box<(Fields<8>, Ticks)>),
    Telemetry(Fields<3>, Telemetry),
    Status(Fields<2>, Fields<{ BoardCounters::NAMES.len() }>, Status),
    Poses(Fields<3>, Poses),
    Broken(Fields<1>, BTreeMap<String, u64>),
    Drops(Fields<1>, u64),
    Nothing,
}

impl Stats {
    /// Counts the `chosen` of the `kinds`.
    pub(super) fn new(kinds: &[Kind], chosen: &[usize]) -> Self {
        let topic = |(index, kind): (usize, &Kind)| {
            let name = kind.name;
            chosen.contains(&index).then(|| (name, Arrivals::default()))
        };
        Self {
            topics: kinds.iter().enumerate().map(topic).collect(),
            counters: kinds.iter().map(Counter::of).collect(),
            first_ns: None,
            last_ns: None,
            brief: false,
        }
    }

    /// Whether the page leaves out the distributions.
    pub(super) const fn brief(mut self, brief: bool) -> Self {
        self.brief = brief;
        self
    }

    /// Counts a row.
    pub(super) fn add(&mut self, row: &Row, values: &[Value]) {
        if let Some(time_ns) = row.time_ns {
            self.first_ns = Some(self.first_ns.map_or(time_ns, |first| first.min(time_ns)));
            self.last_ns = Some(self.last_ns.map_or(time_ns, |last| last.max(time_ns)));
        }
        if let Some(Some((_, arrivals))) = self.topics.get_mut(row.kind) {
            arrivals.add(row.time_ns);
        }
        if let Some(counter) = self.counters.get_mut(row.kind) {
            counter.add(row.time_ns.unwrap_or_default(), values);
        }
    }

    /// What has been counted.
    pub(super) fn report(&self, source: &str, close: &Close) -> Report {
        let span_s = match (self.first_ns, self.last_ns) {
            (Some(first), Some(last)) => seconds(last - first),
            _ => 0.0,
        };
        let topics = self.topics.iter().flatten();
        let mut report = Report {
            source: source.to_owned(),
            brief: self.brief,
            unfinished: close.unfinished,
            missed: close.missed,
            span_s,
            topics: topics
                .map(|(name, arrivals)| topic_report(name, arrivals))
                .collect(),
            ..Report::default()
        };
        if let Some(bytes) = close.line_bytes {
            report.line.bytes = Some(bytes);
            report.line.bytes_per_s = (span_s > 0.0).then(|| bytes as f64 / span_s);
        }
        let end_ns = self.last_ns.unwrap_or_default();
        for counter in &self.counters {
            counter.report(end_ns, &mut report);
        }
        report
    }
}

/// Where some fields of a kind are.
struct Fields<const N: usize>([Option<usize>; N]);

impl<const N: usize> Fields<N> {
    fn of(kind: &Kind, names: [&str; N]) -> Self {
        Self(names.map(|name| kind.index(name)))
    }

    /// Their values in a row.
    fn read<'a>(&self, values: &'a [Value]) -> [&'a Value; N] {
        let value = |field: Option<usize>| values.get(field?);
        self.0.map(|field| value(field).unwrap_or(&Value::Absent))
    }
}

impl Counter {
    fn of(kind: &Kind) -> Self {
        match kind.name.parse() {
            Ok(Topic::Tick) => {
                let fields = [
                    "mode",
                    "reason",
                    "held",
                    "skipped",
                    "events_dropped",
                    "drive.written",
                    "lateness_ns",
                    "capture_to_command_ns",
                ];
                Self::Ticks(Box::new((Fields::of(kind, fields), Ticks::default())))
            }
            Ok(Topic::Telemetry) => {
                let fields = ["board_time_us", "mode", "stop_cause"];
                Self::Telemetry(Fields::of(kind, fields), Telemetry::default())
            }
            Ok(Topic::Status) => {
                let counts = Fields::of(kind, BoardCounters::NAMES);
                let fields = ["board_time_us", "last_refusal"];
                Self::Status(Fields::of(kind, fields), counts, Status::default())
            }
            Ok(Topic::Pose) => {
                let fields = ["frame_number", "state", "rejected"];
                Self::Poses(Fields::of(kind, fields), Poses::default())
            }
            Ok(Topic::Drops) => Self::Drops(Fields::of(kind, ["entries"]), 0),
            _ if kind.name == BROKEN => Self::Broken(Fields::of(kind, ["reason"]), BTreeMap::new()),
            _ => Self::Nothing,
        }
    }

    fn add(&mut self, time_ns: i64, values: &[Value]) {
        match self {
            Self::Ticks(ticks) => {
                let (fields, ticks) = ticks.as_mut();
                ticks.add(time_ns, fields.read(values));
            }
            Self::Telemetry(fields, telemetry) => telemetry.add(time_ns, fields.read(values)),
            Self::Status(fields, counts, status) => {
                status.add(fields.read(values), counts.read(values));
            }
            Self::Poses(fields, poses) => poses.add(time_ns, fields.read(values)),
            Self::Broken(fields, counts) => {
                let [reason] = fields.read(values);
                count(counts, word(reason).to_owned());
            }
            // The count since the record began.
            Self::Drops(fields, entries) => {
                let [now] = fields.read(values);
                *entries = (*entries).max(number(now).unwrap_or_default() as u64);
            }
            Self::Nothing => {}
        }
    }

    fn report(&self, end_ns: i64, report: &mut Report) {
        match self {
            Self::Ticks(ticks) => ticks.1.report(end_ns, report),
            Self::Telemetry(_, telemetry) => telemetry.report(end_ns, report),
            Self::Status(.., status) => report.board.clone_from(&status.counters),
            Self::Poses(_, poses) => report.poses = poses.report(),
            Self::Broken(_, counts) => report.line.broken.clone_from(counts),
            Self::Drops(_, entries) => report.entries_dropped = *entries,
            Self::Nothing => {}
        }
    }
}

fn topic_report(topic: &'static str, arrivals: &Arrivals) -> TopicReport {
    let gap = arrivals.longest_gap();
    TopicReport {
        topic,
        count: arrivals.count(),
        rate_hz: arrivals.rate_hz(),
        first_s: arrivals.first_ns().map(seconds),
        last_s: arrivals.last_ns().map(seconds),
        longest_gap_ms: gap.map(|gap| milliseconds(gap.longest_ns)),
        longest_gap_at_s: gap.map(|gap| seconds(gap.begin_ns)),
    }
}

/// Which modes there were, for how long, and why.
#[derive(Default)]
struct Modes {
    spans: Vec<(i64, String, Option<String>)>,
}

impl Modes {
    fn add(&mut self, time_ns: i64, mode: &str, reason: Option<&str>) {
        let same = self
            .spans
            .last()
            .is_some_and(|(_, last, why)| last == mode && why.as_deref() == reason);
        if !same {
            let reason = reason.map(ToOwned::to_owned);
            self.spans.push((time_ns, mode.to_owned(), reason));
        }
    }

    fn report(&self, end_ns: i64) -> Vec<ModeSpan> {
        let ends = self.spans.iter().skip(1).map(|(begin_ns, ..)| *begin_ns);
        self.spans
            .iter()
            .zip(ends.chain([end_ns]))
            .map(|((begin_ns, mode, reason), end_ns)| ModeSpan {
                mode: mode.clone(),
                reason: reason.clone(),
                from_s: seconds(*begin_ns),
                duration_s: seconds(end_ns - begin_ns),
            })
            .collect()
    }
}

/// Ticks of the control thread.
#[derive(Default)]
struct Ticks {
    counts: TickReport,
    /// In us, as all that is reported of them.
    lateness_us: Vec<f64>,
    capture_to_command_us: Vec<f64>,
    modes: Modes,
}

impl Ticks {
    fn add(
        &mut self,
        time_ns: i64,
        [
            mode,
            reason,
            held,
            skipped,
            dropped,
            written,
            lateness,
            latency,
        ]: [&Value; 8],
    ) {
        let counts = &mut self.counts;
        let held = *held == Value::Bool(true);
        counts.skipped += number(skipped).unwrap_or_default() as u64;
        counts.events_dropped += number(dropped).unwrap_or_default() as u64;
        counts.without_new_pose += u64::from(held);
        counts.commands_not_written += u64::from(*written == Value::Bool(false));
        self.lateness_us.extend(number(lateness).map(microseconds));
        // In a held tick the pose is an old one, which says nothing of the latency.
        if !held {
            self.capture_to_command_us
                .extend(number(latency).map(microseconds));
        }
        if let Some(mode) = text(mode) {
            self.modes.add(time_ns, mode, text(reason));
        }
    }

    fn report(&self, end_ns: i64, report: &mut Report) {
        report.ticks = (!self.lateness_us.is_empty()).then(|| self.counts.clone());
        report.lateness = Durations::of(&self.lateness_us);
        report.capture_to_command = Durations::of(&self.capture_to_command_us);
        report.modes = self.modes.report(end_ns);
    }
}

/// Lost telemetry, by the board's clock.
#[derive(Default)]
struct Telemetry {
    last: Option<(i64, u32)>,
    lost: u64,
    gaps: u64,
    restarts: u64,
    longest: Gap,
    modes: Modes,
}

impl Telemetry {
    fn add(&mut self, time_ns: i64, [board_time, mode, cause]: [&Value; 3]) {
        let Some(board_us) = number(board_time) else {
            return;
        };
        let board_us = board_us as u32;
        if let Some((last_ns, last_us)) = self.last {
            let passed_us = board_us.wrapping_sub(last_us);
            if passed_us.cast_signed() < 0 {
                self.restarts += 1;
            } else {
                // Rounded: a record may be up to half a period early or late.
                let periods = (passed_us + TELEMETRY_PERIOD_US / 2) / TELEMETRY_PERIOD_US;
                let lost = periods.saturating_sub(1);
                if lost > 0 {
                    self.lost += u64::from(lost);
                    self.gaps += 1;
                    let begin_ns = last_ns;
                    self.longest
                        .add(begin_ns, begin_ns + i64::from(passed_us) * 1_000);
                }
            }
        }
        self.last = Some((time_ns, board_us));
        if let Some(mode) = text(mode) {
            let cause = text(cause).filter(|cause| *cause != "none");
            self.modes.add(time_ns, mode, cause);
        }
    }

    fn report(&self, end_ns: i64, report: &mut Report) {
        if self.last.is_none() {
            return;
        }
        let line = &mut report.line;
        line.telemetry = true;
        line.telemetry_lost = self.lost;
        line.gaps = self.gaps;
        line.board_restarts = self.restarts;
        line.longest_gap_ms = (self.gaps > 0).then(|| milliseconds(self.longest.longest_ns));
        line.longest_gap_at_s = (self.gaps > 0).then(|| seconds(self.longest.begin_ns));
        report.board_modes = self.modes.report(end_ns);
    }
}

/// The board's counters, which wrap, and start at zero when the board restarts.
#[derive(Default)]
struct Status {
    last: Option<(u32, [u16; BoardCounters::NAMES.len()])>,
    counters: Option<BoardCounters>,
}

impl Status {
    fn add(
        &mut self,
        [board_time, refusal]: [&Value; 2],
        now: [&Value; BoardCounters::NAMES.len()],
    ) {
        let board_us = number(board_time).unwrap_or_default() as u32;
        let now = now.map(|count| number(count).unwrap_or_default() as u16);
        let counters = self.counters.get_or_insert_default();
        let before = match self.last {
            Some((last_us, _)) if board_us.wrapping_sub(last_us).cast_signed() < 0 => [0; _],
            Some((_, last)) => last,
            // Counts before the record began do not belong to it.
            None => now,
        };
        for ((sum, now), before) in counters.counts.iter_mut().zip(now).zip(before) {
            *sum += u64::from(now.wrapping_sub(before));
        }
        let refusal = text(refusal).filter(|refusal| *refusal != "none");
        counters.last_refusal = refusal.map(ToOwned::to_owned);
        self.last = Some((board_us, now));
    }
}

/// Poses and frames of the motion capture.
#[derive(Default)]
struct Poses {
    last_frame: Option<i64>,
    last_valid_ns: Option<i64>,
    frames_missing: u64,
    between_valid: Gap,
    states: BTreeMap<String, u64>,
}

impl Poses {
    fn add(&mut self, time_ns: i64, [frame_number, state, rejected]: [&Value; 3]) {
        let state = word(state);
        if let Some(number) = number(frame_number) {
            // Numbers that go back belong to another stream.
            let missing = self.last_frame.map_or(0, |last| number - last - 1);
            self.frames_missing += u64::try_from(missing).unwrap_or_default();
            self.last_frame = Some(number);
        }
        if state == "valid" {
            if let Some(last_ns) = self.last_valid_ns {
                self.between_valid.add(last_ns, time_ns);
            }
            self.last_valid_ns = Some(time_ns);
        }
        match text(rejected) {
            Some(why) => count(&mut self.states, format!("{state}: {why}")),
            None => count(&mut self.states, state.to_owned()),
        }
    }

    fn report(&self) -> Option<PoseReport> {
        let between = (self.between_valid.longest_ns > 0).then_some(self.between_valid);
        (!self.states.is_empty()).then(|| PoseReport {
            states: self.states.clone(),
            frames_missing: self.frames_missing,
            longest_between_valid_ms: between.map(|gap| milliseconds(gap.longest_ns)),
            longest_between_valid_at_s: between.map(|gap| seconds(gap.begin_ns)),
        })
    }
}

fn count(counts: &mut BTreeMap<String, u64>, what: String) {
    *counts.entry(what).or_default() += 1;
}

fn number(value: &Value) -> Option<i64> {
    match value {
        Value::Unsigned(value) => i64::try_from(*value).ok(),
        Value::Signed(value) => Some(*value),
        _ => None,
    }
}

fn text(value: &Value) -> Option<&str> {
    match value {
        Value::Text(text) => Some(text),
        _ => None,
    }
}

fn word(value: &Value) -> &str {
    text(value).unwrap_or("unknown")
}

fn seconds(ns: i64) -> f64 {
    ns as f64 / 1e9
}

fn microseconds(ns: i64) -> f64 {
    ns as f64 / 1e3
}

fn milliseconds(ns: i64) -> f64 {
    ns as f64 / 1e6
}
