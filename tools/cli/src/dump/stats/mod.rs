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
use report::{
    BoardCounters, Count, Durations, ModeSpan, PoseReport, Report, TickReport, TopicReport,
};

/// Counts rows.
pub(super) struct Stats {
    /// The name of each kind, and its arrivals if it is counted.
    topics: Vec<Option<(&'static str, Arrivals)>>,
    counters: Vec<Counter>,
    first_ns: Option<i64>,
    last_ns: Option<i64>,
    brief: bool,
}

/// What is counted of a kind besides its rate.
enum Counter {
    Ticks(Box<Ticks>),
    Telemetry(Telemetry),
    Status(Status),
    Poses(Poses),
    Broken(Broken),
    Drops(Option<usize>, u64),
    Nothing,
}

impl Stats {
    /// Counts the `chosen` of the `kinds`.
    pub(super) fn new(kinds: &[Kind], chosen: &[usize]) -> Self {
        let topic = |index, kind: &Kind| {
            let name = kind.name;
            chosen.contains(&index).then(|| (name, Arrivals::default()))
        };
        Self {
            topics: kinds
                .iter()
                .enumerate()
                .map(|(index, kind)| topic(index, kind))
                .collect(),
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

impl Counter {
    fn of(kind: &Kind) -> Self {
        let name = kind.name;
        if name == Topic::Tick.name() {
            Self::Ticks(Box::new(Ticks::new(kind)))
        } else if name == Topic::Telemetry.name() {
            Self::Telemetry(Telemetry::new(kind))
        } else if name == Topic::Status.name() {
            Self::Status(Status::new(kind))
        } else if name == Topic::Pose.name() {
            Self::Poses(Poses::new(kind))
        } else if name == Topic::Drops.name() {
            Self::Drops(kind.index("entries"), 0)
        } else if name == BROKEN {
            Self::Broken(Broken {
                reason: kind.index("reason"),
                counts: BTreeMap::new(),
            })
        } else {
            Self::Nothing
        }
    }

    fn add(&mut self, time_ns: i64, values: &[Value]) {
        match self {
            Self::Ticks(ticks) => ticks.add(time_ns, values),
            Self::Telemetry(telemetry) => telemetry.add(time_ns, values),
            Self::Status(status) => status.add(values),
            Self::Poses(poses) => poses.add(time_ns, values),
            Self::Broken(broken) => count(&mut broken.counts, word(values, broken.reason)),
            // The count since the record began.
            Self::Drops(field, entries) => {
                *entries = (*entries).max(number(values, *field).unwrap_or_default() as u64);
            }
            Self::Nothing => {}
        }
    }

    fn report(&self, end_ns: i64, report: &mut Report) {
        match self {
            Self::Ticks(ticks) => ticks.report(end_ns, report),
            Self::Telemetry(telemetry) => telemetry.report(end_ns, report),
            Self::Status(status) => report.board.clone_from(&status.counters),
            Self::Poses(poses) => report.poses = poses.report(),
            Self::Broken(broken) => report.line.broken = counts(&broken.counts),
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
struct Ticks {
    fields: TickFields,
    counts: TickReport,
    /// In us, as all that is reported of them.
    lateness_us: Vec<f64>,
    capture_to_command_us: Vec<f64>,
    modes: Modes,
}

struct TickFields {
    mode: Option<usize>,
    reason: Option<usize>,
    held: Option<usize>,
    skipped: Option<usize>,
    events_dropped: Option<usize>,
    written: Option<usize>,
    lateness: Option<usize>,
    capture_to_command: Option<usize>,
}

impl Ticks {
    fn new(kind: &Kind) -> Self {
        Self {
            fields: TickFields {
                mode: kind.index("mode"),
                reason: kind.index("reason"),
                held: kind.index("held"),
                skipped: kind.index("skipped"),
                events_dropped: kind.index("events_dropped"),
                written: kind.index("drive.written"),
                lateness: kind.index("lateness_ns"),
                capture_to_command: kind.index("capture_to_command_ns"),
            },
            counts: TickReport::default(),
            lateness_us: Vec::new(),
            capture_to_command_us: Vec::new(),
            modes: Modes::default(),
        }
    }

    fn add(&mut self, time_ns: i64, values: &[Value]) {
        let fields = &self.fields;
        let counts = &mut self.counts;
        let held = truth(values, fields.held) == Some(true);
        counts.skipped += number(values, fields.skipped).unwrap_or_default() as u64;
        counts.events_dropped += number(values, fields.events_dropped).unwrap_or_default() as u64;
        counts.without_new_pose += u64::from(held);
        counts.commands_not_written += u64::from(truth(values, fields.written) == Some(false));
        self.lateness_us
            .extend(number(values, fields.lateness).map(microseconds));
        // In a held tick the pose is an old one, which says nothing of the latency.
        if !held {
            self.capture_to_command_us
                .extend(number(values, fields.capture_to_command).map(microseconds));
        }
        if let Some(mode) = text(values, fields.mode) {
            self.modes.add(time_ns, mode, text(values, fields.reason));
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
struct Telemetry {
    board_time: Option<usize>,
    mode: Option<usize>,
    cause: Option<usize>,
    last: Option<(i64, u32)>,
    lost: u64,
    gaps: u64,
    restarts: u64,
    longest: Gap,
    modes: Modes,
}

impl Telemetry {
    fn new(kind: &Kind) -> Self {
        Self {
            board_time: kind.index("board_time_us"),
            mode: kind.index("mode"),
            cause: kind.index("stop_cause"),
            last: None,
            lost: 0,
            gaps: 0,
            restarts: 0,
            longest: Gap::default(),
            modes: Modes::default(),
        }
    }

    fn add(&mut self, time_ns: i64, values: &[Value]) {
        let Some(board_us) = number(values, self.board_time) else {
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
        if let Some(mode) = text(values, self.mode) {
            let cause = text(values, self.cause).filter(|cause| *cause != "none");
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
struct Status {
    board_time: Option<usize>,
    refusal: Option<usize>,
    fields: [Option<usize>; BoardCounters::NAMES.len()],
    last: Option<(u32, [u16; BoardCounters::NAMES.len()])>,
    counters: Option<BoardCounters>,
}

impl Status {
    fn new(kind: &Kind) -> Self {
        Self {
            board_time: kind.index("board_time_us"),
            refusal: kind.index("last_refusal"),
            fields: BoardCounters::NAMES.map(|name| kind.index(name)),
            last: None,
            counters: None,
        }
    }

    fn add(&mut self, values: &[Value]) {
        let board_us = number(values, self.board_time).unwrap_or_default() as u32;
        let now = self
            .fields
            .map(|field| number(values, field).unwrap_or_default() as u16);
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
        counters.last_refusal = text(values, self.refusal)
            .filter(|refusal| *refusal != "none")
            .map(ToOwned::to_owned);
        self.last = Some((board_us, now));
    }
}

/// Poses and frames of the motion capture.
struct Poses {
    frame_number: Option<usize>,
    state: Option<usize>,
    rejected: Option<usize>,
    last_frame: Option<i64>,
    last_valid_ns: Option<i64>,
    frames_missing: u64,
    between_valid: Gap,
    states: BTreeMap<String, u64>,
}

impl Poses {
    fn new(kind: &Kind) -> Self {
        Self {
            frame_number: kind.index("frame_number"),
            state: kind.index("state"),
            rejected: kind.index("rejected"),
            last_frame: None,
            last_valid_ns: None,
            frames_missing: 0,
            between_valid: Gap::default(),
            states: BTreeMap::new(),
        }
    }

    fn add(&mut self, time_ns: i64, values: &[Value]) {
        let state = word(values, self.state);
        if let Some(number) = number(values, self.frame_number) {
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
        match text(values, self.rejected) {
            Some(why) => count(&mut self.states, format!("{state}: {why}")),
            None => count(&mut self.states, state),
        }
    }

    fn report(&self) -> Option<PoseReport> {
        let between = (self.between_valid.longest_ns > 0).then_some(self.between_valid);
        (!self.states.is_empty()).then(|| PoseReport {
            states: counts(&self.states),
            frames_missing: self.frames_missing,
            longest_between_valid_ms: between.map(|gap| milliseconds(gap.longest_ns)),
            longest_between_valid_at_s: between.map(|gap| seconds(gap.begin_ns)),
        })
    }
}

/// Bytes that are not a frame.
struct Broken {
    reason: Option<usize>,
    counts: BTreeMap<String, u64>,
}

fn count(counts: &mut BTreeMap<String, u64>, what: String) {
    *counts.entry(what).or_default() += 1;
}

fn counts(counts: &BTreeMap<String, u64>) -> Vec<Count> {
    counts
        .iter()
        .map(|(what, count)| Count {
            what: what.clone(),
            count: *count,
        })
        .collect()
}

fn number(values: &[Value], field: Option<usize>) -> Option<i64> {
    match values.get(field?)? {
        Value::Unsigned(value) => i64::try_from(*value).ok(),
        Value::Signed(value) => Some(*value),
        _ => None,
    }
}

fn truth(values: &[Value], field: Option<usize>) -> Option<bool> {
    match values.get(field?)? {
        Value::Bool(value) => Some(*value),
        _ => None,
    }
}

fn text(values: &[Value], field: Option<usize>) -> Option<&str> {
    match values.get(field?)? {
        Value::Text(text) => Some(text),
        _ => None,
    }
}

fn word(values: &[Value], field: Option<usize>) -> String {
    text(values, field).unwrap_or("unknown").to_owned()
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
