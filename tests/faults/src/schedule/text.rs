//! Text form of schedules: entries separated by newlines or `;`.

use core::fmt;
use std::str::FromStr;

use singletrack_sim::EscKind;

use super::{
    Deviation, Fault, FaultKind, OperatorRequest, ReferenceKind, Schedule, ScheduledRequest,
    Situation, TrueCar,
};

/// Error while parsing a schedule.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScheduleError {
    /// An entry that does not parse.
    #[error("invalid schedule entry {entry:?}: expected {expected}")]
    Entry {
        /// The entry as written.
        entry: String,
        /// The accepted forms.
        expected: &'static str,
    },
    /// A mandatory entry is missing.
    #[error("the schedule has no {0}")]
    Missing(&'static str),
}

const EXPECTED: &str = "seed N, board native|uno, reference circle|eight|steps|external, a key of the \
                        situation and its value, truth PROPERTY N, end_ms N, ask arm|disarm|stop|reload|carry|gone|time-up|halt|jog|\
                        jog-on|lift|put-down at MS, or fault KIND at MS for MS severity 1..1000";

impl fmt::Display for Schedule {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let s = &self.situation;
        writeln!(out, "seed {}", self.seed)?;
        writeln!(out, "board {}", s.board)?;
        writeln!(out, "reference {}", s.reference.name())?;
        writeln!(out, "speed_mm_s {}", s.speed_mm_s)?;
        for (key, value) in [
            ("coast", s.coast),
            ("brake", s.brake),
            ("stop_input", s.stop_input),
            ("kill_output", s.kill_output),
            ("proved", s.proved),
            ("reset_on_open", s.reset_on_open),
            ("own_supply", s.own_supply),
            ("queue_shows", s.queue_shows),
            ("safety_filter", s.safety_filter),
            ("steering_table", s.steering_table),
            ("tuning", s.tuning),
            ("live", s.live),
            ("attended", s.attended),
            ("waits", s.waits),
        ] {
            writeln!(out, "{key} {value}")?;
        }
        writeln!(out, "esc_kind {}", esc_name(s.esc_kind))?;
        writeln!(out, "neutral_us {}", s.neutral_us)?;
        writeln!(out, "fence_mm {}", s.fence_mm)?;
        writeln!(out, "braking_mm_s2 {}", s.braking_mm_s2)?;
        writeln!(out, "pulse_distance_um {}", s.pulse_distance_um)?;
        writeln!(out, "camera_latency_ms {}", s.camera_latency_ms)?;
        writeln!(out, "serial_delay_us {}", s.serial_delay_us)?;
        writeln!(out, "board_skew_ppm {}", s.board_skew_ppm)?;
        writeln!(out, "board_clock_ms {}", s.board_clock_ms)?;
        if let Some(esc) = self.truth.esc {
            writeln!(out, "truth esc-kind {}", esc_name(esc))?;
        }
        for (deviation, value) in &self.truth.deviations {
            writeln!(out, "truth {} {value}", deviation.name())?;
        }
        writeln!(out, "end_ms {}", self.end_ms)?;
        for ask in &self.requests {
            writeln!(out, "{ask}")?;
        }
        for fault in &self.faults {
            writeln!(out, "{fault}")?;
        }
        Ok(())
    }
}

impl fmt::Display for ScheduledRequest {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "ask {} at {}", self.request.name(), self.at_ms)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "fault {} at {} for {} severity {}",
            self.kind.name(),
            self.at_ms,
            self.for_ms,
            self.severity
        )
    }
}

impl Schedule {
    /// The schedule as one line.
    pub fn in_one_line(&self) -> String {
        self.to_string().trim_end().replace('\n', "; ")
    }
}

impl FromStr for Schedule {
    type Err = ScheduleError;

    fn from_str(text: &str) -> Result<Self, ScheduleError> {
        let mut draft = Draft::default();
        for line in text.lines() {
            // A line may end with a comment.
            let line = line.split('#').next().unwrap_or_default();
            for entry in line.split(';').map(str::trim) {
                if !entry.is_empty() {
                    draft.take(entry).ok_or_else(|| ScheduleError::Entry {
                        entry: entry.to_owned(),
                        expected: EXPECTED,
                    })?;
                }
            }
        }
        draft.finish()
    }
}

#[derive(Default)]
struct Draft {
    seed: Option<u64>,
    end_ms: Option<u32>,
    situation: Situation,
    truth: TrueCar,
    requests: Vec<ScheduledRequest>,
    faults: Vec<Fault>,
}

impl Draft {
    fn take(&mut self, entry: &str) -> Option<()> {
        let words: Vec<&str> = entry.split_whitespace().collect();
        let s = &mut self.situation;
        match words.as_slice() {
            ["seed", n] => self.seed = Some(n.parse().ok()?),
            ["end_ms", n] => self.end_ms = Some(n.parse().ok()?),
            ["board", kind] => s.board = kind.parse().ok()?,
            ["reference", name] => s.reference = ReferenceKind::named(name)?,
            ["speed_mm_s", n] => s.speed_mm_s = n.parse().ok()?,
            ["coast", yes] => s.coast = yes.parse().ok()?,
            ["brake", yes] => s.brake = yes.parse().ok()?,
            ["stop_input", yes] => s.stop_input = yes.parse().ok()?,
            ["reset_on_open", yes] => s.reset_on_open = yes.parse().ok()?,
            ["own_supply", yes] => s.own_supply = yes.parse().ok()?,
            ["queue_shows", yes] => s.queue_shows = yes.parse().ok()?,
            ["safety_filter", yes] => s.safety_filter = yes.parse().ok()?,
            ["steering_table", yes] => s.steering_table = yes.parse().ok()?,
            ["tuning", yes] => s.tuning = yes.parse().ok()?,
            ["live", yes] => s.live = yes.parse().ok()?,
            ["attended", yes] => s.attended = yes.parse().ok()?,
            ["waits", yes] => s.waits = yes.parse().ok()?,
            ["fence_mm", n] => s.fence_mm = n.parse().ok()?,
            ["esc_kind", name] => {
                s.esc_kind = esc_named(name).filter(|kind| *kind != EscKind::LearnsNeutral)?;
            }
            ["neutral_us", n] => s.neutral_us = n.parse().ok()?,
            ["proved", yes] => s.proved = yes.parse().ok()?,
            ["kill_output", yes] => s.kill_output = yes.parse().ok()?,
            ["braking_mm_s2", n] => s.braking_mm_s2 = n.parse().ok().filter(|n| *n > 0)?,
            ["pulse_distance_um", n] => s.pulse_distance_um = n.parse().ok()?,
            ["truth", "esc-kind", name] => self.truth.esc = Some(esc_named(name)?),
            ["truth", name, value] => {
                let deviation = Deviation::named(name)?;
                let value = value.parse().ok();
                let value = value.filter(|value| deviation.possible().contains(value))?;
                self.truth.deviations.insert(deviation, value);
            }
            ["camera_latency_ms", n] => s.camera_latency_ms = n.parse().ok()?,
            ["serial_delay_us", n] => s.serial_delay_us = n.parse().ok()?,
            ["board_skew_ppm", n] => s.board_skew_ppm = n.parse().ok()?,
            ["board_clock_ms", n] => s.board_clock_ms = n.parse().ok()?,
            ["ask", request, "at", at] => self.requests.push(ScheduledRequest {
                request: OperatorRequest::named(request)?,
                at_ms: at.parse().ok()?,
            }),
            [
                "fault",
                kind,
                "at",
                at,
                "for",
                duration,
                "severity",
                severity,
            ] => self.faults.push(Fault {
                kind: *FaultKind::ALL.iter().find(|known| known.name() == *kind)?,
                at_ms: at.parse().ok()?,
                for_ms: duration.parse().ok()?,
                severity: severity.parse().ok().filter(|s| (1..=1_000).contains(s))?,
            }),
            _ => return None,
        }
        Some(())
    }

    fn finish(mut self) -> Result<Schedule, ScheduleError> {
        self.requests.sort_by_key(|request| request.at_ms);
        Ok(Schedule {
            seed: self.seed.ok_or(ScheduleError::Missing("seed"))?,
            situation: self.situation,
            truth: self.truth,
            end_ms: self.end_ms.ok_or(ScheduleError::Missing("end_ms"))?,
            requests: self.requests,
            faults: self.faults,
        })
    }
}

const ESC_KINDS: [(EscKind, &str); 4] = [
    (EscKind::Car, "car"),
    (EscKind::ForwardReverse, "forward-reverse"),
    (EscKind::Vesc, "vesc"),
    (EscKind::LearnsNeutral, "learns-neutral"),
];

fn esc_name(kind: EscKind) -> &'static str {
    let mut kinds = ESC_KINDS.iter();
    kinds
        .find(|(known, _)| *known == kind)
        .map_or("", |(_, name)| name)
}

fn esc_named(name: &str) -> Option<EscKind> {
    let mut kinds = ESC_KINDS.iter();
    Some(kinds.find(|(_, known)| *known == name)?.0)
}

impl ReferenceKind {
    const ALL: [Self; 4] = [Self::Circle, Self::Eight, Self::Steps, Self::External];

    const fn name(self) -> &'static str {
        match self {
            Self::Circle => "circle",
            Self::Eight => "eight",
            Self::Steps => "steps",
            Self::External => "external",
        }
    }

    fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

impl OperatorRequest {
    const ALL: [Self; 12] = [
        Self::Arm,
        Self::Disarm,
        Self::Stop,
        Self::Reload,
        Self::Carry,
        Self::Gone,
        Self::TimeUp,
        Self::Halt,
        Self::Jog,
        Self::JogOn,
        Self::Lift,
        Self::PutDown,
    ];

    const fn name(self) -> &'static str {
        match self {
            Self::Arm => "arm",
            Self::Disarm => "disarm",
            Self::Stop => "stop",
            Self::Reload => "reload",
            Self::Carry => "carry",
            Self::Gone => "gone",
            Self::TimeUp => "time-up",
            Self::Halt => "halt",
            Self::Jog => "jog",
            Self::JogOn => "jog-on",
            Self::Lift => "lift",
            Self::PutDown => "put-down",
        }
    }

    fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|request| request.name() == name)
    }
}
