//! When two states are the same: what no claim and no deadline tells apart.
//!
//! The text of `Debug` is read, so that a new field counts unless it is named here. What is
//! absolute becomes relative: times to now, numbers of requests and commands to those that the
//! session gives next, pulses to those so far, nonces to each other. Times beyond every deadline
//! are one.

use std::{
    fmt::Write as _,
    hash::{DefaultHasher, Hasher as _},
};

use singletrack_pilot::Mode;
use singletrack_protocol::BoardMode;

use crate::world::World;

/// Fields that decide nothing, with the reason.
const SKIPPED: &[(&str, &str)] = &[
    ("now", "all other times are relative to it"),
    ("board_start", "the same on the board"),
    ("seeds", "sessions differ by their nonces"),
    ("nonces", "nonces do not repeat"),
    ("config", "its hash counts, limits are constant"),
    ("configuration", "its hash counts"),
    ("decoder", "frames pass whole: between them it is empty"),
    ("counters", "for people"),
    ("quality", "for people; the share of damaged frames is zero"),
    ("board_quality", "the same"),
    ("latency", "for people"),
    (
        "points",
        "both clocks are exact: every history gives the same line",
    ),
    ("edge", "the same"),
    ("line", "the same"),
    ("host_ns", "the same"),
    ("newest_elapsed_us", "the same"),
    ("since_ns", "for people"),
    ("frames_received", "for people"),
    ("frames_damaged", "for people"),
    ("frames_dropped", "for people"),
    ("drives_refused", "for people"),
    ("last_refusal", "for people"),
    ("reset_cause", "for people"),
    ("in_gear", "there is no gear but forward"),
];

/// The period of the board's slowest message, ns.
const STATUS_NS: i64 = 200_000_000;

/// A time on the host's clock, ns, beyond which all are one: the supervisor's longest wait for
/// what it has heard is a second; `disarm_age` is less.
const HOST_LIMIT_NS: i64 = 1_100_000_000;

/// That of what the link hears, and of the IMU.
const LINK_LIMIT_NS: i64 = 220_000_000;

/// That of the time since a mode began: `stop_timeout`, and powering up.
const MODE_LIMIT_NS: i64 = 3_200_000_000;

/// A time on the board's clock, µs, beyond which all are one.
const BOARD_LIMIT_US: i64 = 500_000;

/// Request numbers further apart are one: a number is not used again before 256 requests.
const FAR: i64 = 4;

/// A key of the state: equal states have equal keys.
pub(crate) type Key = u64;

/// Reads states.
#[derive(Debug, Default)]
pub(crate) struct Canonical {
    text: String,
    out: Vec<u8>,
    nonces: Vec<u64>,
}

impl Canonical {
    pub(crate) fn key(&mut self, world: &World) -> Key {
        self.text.clear();
        // Writing to a string does not fail.
        let _ = write!(self.text, "{world:?}");
        self.out.clear();
        self.nonces.clear();
        let mode = world.host.supervisor.mode();
        let mut reader = Reader {
            rest: &self.text,
            out: &mut self.out,
            nonces: &mut self.nonces,
            skips: 0,
            now_ns: world.now.0,
            board_us: world.board_us(),
            pulses: world.pulses(),
            request: number_after(&self.text, "next_request: Sequence("),
            drive: number_after(&self.text, "last_drive: Sequence("),
            waits: matches!(mode, Mode::Arming | Mode::Stopping),
            no_health: false,
            armed: matches!(world.board.mode(), BoardMode::Armed | BoardMode::PoweringUp),
        };
        reader.value("", "");
        let mut hasher = DefaultHasher::new();
        hasher.write(&self.out);
        hasher.finish()
    }
}

fn number_after(text: &str, what: &str) -> i64 {
    let at = text.find(what).map_or(0, |at| at + what.len());
    let digits = text[at..].bytes().take_while(u8::is_ascii_digit).count();
    text[at..at + digits].parse().unwrap_or(0)
}

struct Reader<'a> {
    rest: &'a str,
    out: &'a mut Vec<u8>,
    nonces: &'a mut Vec<u64>,
    /// Above zero nothing is written.
    skips: u32,
    now_ns: u64,
    board_us: u32,
    pulses: u16,
    request: i64,
    drive: i64,
    /// Whether the time since the mode began matters.
    waits: bool,
    /// Whether the board waits for its first command.
    armed: bool,
    /// Whether no message of the board's health counts: then its time does not.
    no_health: bool,
}

impl<'a> Reader<'a> {
    /// A value, in this field of this structure.
    fn value(&mut self, owner: &str, field: &str) {
        if field == "health" {
            self.no_health = self.rest.starts_with("None");
        }
        let skipped = SKIPPED.iter().any(|(name, _)| *name == field);
        self.skips += u32::from(skipped);
        match self.rest.as_bytes().first() {
            Some(b'[') => self.list(']', owner, field),
            Some(b'(') => self.list(')', owner, field),
            Some(b'0'..=b'9' | b'-') => {
                let number =
                    self.take(|byte| byte.is_ascii_alphanumeric() || b"+-.".contains(&byte));
                self.number(owner, field, number);
            }
            _ => {
                let name = self.take(|byte| byte.is_ascii_alphanumeric() || b"_:".contains(&byte));
                assert!(!name.is_empty(), "unexpected text: {:.60}", self.rest);
                self.write(name.as_bytes());
                if self.rest.starts_with(" {") {
                    self.rest = &self.rest[1..];
                    self.fields(name);
                } else if self.rest.starts_with('(') {
                    let wrapper = matches!(name, "Some" | "Time" | "Sequence");
                    self.list(')', if wrapper { owner } else { name }, field);
                }
            }
        }
        self.skips -= u32::from(skipped);
    }

    /// Values up to this end.
    fn list(&mut self, end: char, owner: &str, field: &str) {
        self.rest = &self.rest[1..];
        self.write(b"(");
        while !self.rest.starts_with(end) {
            self.value(owner, field);
            self.rest = self.rest.strip_prefix(", ").unwrap_or(self.rest);
        }
        self.rest = &self.rest[1..];
        self.write(b")");
    }

    /// ` name: value, ... }` after the brace.
    fn fields(&mut self, owner: &str) {
        self.rest = &self.rest[1..];
        loop {
            self.rest = self.rest.trim_start_matches([' ', ',']);
            if let Some(rest) = self.rest.strip_prefix('}') {
                self.rest = rest;
                return;
            }
            let field = self.take(|byte| byte != b':');
            self.rest = &self.rest[2..];
            self.write(b",");
            self.value(owner, field);
        }
    }

    fn take(&mut self, belongs: impl Fn(u8) -> bool) -> &'a str {
        let length = self.rest.bytes().take_while(|&byte| belongs(byte)).count();
        let (taken, rest) = self.rest.split_at(length);
        self.rest = rest;
        taken
    }

    fn write(&mut self, bytes: &[u8]) {
        if self.skips == 0 {
            self.out.extend_from_slice(bytes);
        }
    }

    fn number(&mut self, owner: &str, field: &str, text: &str) {
        let Ok(value) = text.parse::<i64>() else {
            return self.write(text.as_bytes());
        };
        let near = |difference: i64, limit: i64| difference.clamp(-limit, limit);
        let steps = |base: i64| {
            let difference = i64::from((value - base) as i8);
            near(difference, FAR)
        };
        let relative = match (owner, field) {
            ("Stopwatch", "armed") if !self.armed => 0,
            ("Stopwatch", _) => near(value, watch_limit_us(field)),
            (_, "since") if self.is_host_time(field) => {
                if self.waits {
                    near(self.host_age(value), MODE_LIMIT_NS)
                } else {
                    0
                }
            }
            (_, "health_time") if self.no_health => 0,
            (_, "health_time") => near(self.host_age(value), HOST_LIMIT_NS) / STATUS_NS,
            (
                _,
                "last_heard_ns" | "newest_mapped_ns" | "host_time_ns" | "last_imu_time_ns"
                | "imu_time",
            ) => near(self.host_age(value), LINK_LIMIT_NS),
            (_, field) if self.is_host_time(field) => near(self.host_age(value), HOST_LIMIT_NS),
            (
                _,
                "last_poll_us" | "telemetry_time_us" | "last_edge_us" | "time_us" | "newest_raw_us"
                | "board_time_us" | "behind",
            ) => {
                let age = self.board_us.wrapping_sub(value as u32).cast_signed();
                near(age.into(), BOARD_LIMIT_US)
            }
            ("Drive" | "Jog", "sequence") | (_, "last_drive" | "last_sequence") => {
                steps(self.drive)
            }
            (_, "sequence" | "request" | "next_request" | "arm_request") => steps(self.request),
            ("MotorPulses", "count") | (_, "since_count" | "creeping_since_count") => {
                i64::from(self.pulses.wrapping_sub(value as u16).cast_signed()).clamp(-64, 64)
            }
            (_, "nonce" | "announcement" | "greeting") => {
                let nonce = value.cast_unsigned();
                let known = self.nonces.iter().position(|&other| other == nonce);
                known.unwrap_or_else(|| {
                    self.nonces.push(nonce);
                    self.nonces.len() - 1
                }) as i64
            }
            _ => value,
        };
        if self.skips == 0 {
            // Writing to a vector does not fail.
            let _ = std::io::Write::write_fmt(self.out, format_args!("{relative}"));
        }
    }

    fn is_host_time(&self, field: &str) -> bool {
        matches!(
            field,
            "last_heard_ns"
                | "next_ns"
                | "newest_mapped_ns"
                | "host_time_ns"
                | "last_imu_time_ns"
                | "pose_time"
                | "imu_time"
                | "health_time"
                | "resting"
                | "held"
                | "since"
        )
    }

    fn host_age(&self, time_ns: i64) -> i64 {
        self.now_ns
            .wrapping_sub(time_ns.cast_unsigned())
            .cast_signed()
    }
}

/// The board's stopwatches: beyond their longest deadline, all times are one.
fn watch_limit_us(field: &str) -> i64 {
    match field {
        "neutral" => 2_000_000,
        "armed" => 2_000_000,
        // Ten seconds of jogging.
        "jogged" => 10_000_000,
        "failed" => 300_000,
        "rolling" => 3_000_000,
        "creeping" => 5_000_000,
        _ => 700_000,
    }
}
