//! The states of pilot, board and record for diagnostics tools.

use singletrack_pilot::{Mode, Reason};
use singletrack_protocol::{BoardMode, Status, StopCause};

use super::Batch;
use crate::{
    Entry, LinkPhase, StandardTopic,
    standard::{Byte, DiagnosticArray, DiagnosticStatus, KeyValue},
};

const OK: Byte = Byte(0);
const WARN: Byte = Byte(1);
const ERROR: Byte = Byte(2);
const STALE: Byte = Byte(3);

/// The `hardware_id` of every status.
const HARDWARE: &str = "singletrack";

/// The latest states.
#[derive(Debug, Default)]
pub(super) struct Diagnostics {
    pilot: Option<Pilot>,
    board: Option<(BoardMode, StopCause)>,
    status: Option<Status>,
    /// Whether an error counter rose with the last status.
    trouble: bool,
    dropped: u64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Pilot {
    mode: Mode,
    reason: Option<Reason>,
    link: LinkPhase,
}

impl Diagnostics {
    /// Takes an entry, and adds a message if a state has changed or the board has sent its
    /// status.
    pub(super) fn take(&mut self, entry: &Entry, batch: &mut Batch) -> Result<(), String> {
        match entry {
            Entry::Tick(tick) => {
                let pilot = Some(Pilot {
                    mode: tick.output.mode,
                    reason: tick.output.reason,
                    link: tick.link,
                });
                if pilot == self.pilot {
                    return Ok(());
                }
                self.pilot = pilot;
            }
            Entry::Status(record) => {
                self.trouble = self
                    .status
                    .is_some_and(|before| troubles(&before) != troubles(&record.status));
                self.status = Some(record.status);
            }
            Entry::Drops(drops) => self.dropped = drops.entries,
            Entry::Telemetry(record) => {
                self.board = Some((record.telemetry.mode, record.telemetry.stop_cause));
                return Ok(());
            }
            Entry::Pose(_) | Entry::Log(_) | Entry::Configuration(_) => return Ok(()),
        }
        let known = [self.pilot(), self.board(), Some(self.record())];
        let message = DiagnosticArray {
            header: batch.header(entry.time_ns(), ""),
            status: known.into_iter().flatten().collect(),
        };
        batch.add(StandardTopic::Diagnostics, entry.time_ns(), &message)
    }

    fn pilot(&self) -> Option<DiagnosticStatus> {
        let Pilot { mode, reason, link } = self.pilot?;
        let level = match (mode, reason) {
            (Mode::Fault, _) => ERROR,
            (Mode::Ready | Mode::Arming | Mode::Driving, _)
            | (_, None | Some(Reason::Requested | Reason::ReferenceFinished)) => OK,
            (_, Some(_)) => WARN,
        };
        let reason = reason.map_or("none", Reason::name);
        Some(DiagnosticStatus {
            level,
            name: "singletrack: pilot",
            message: match reason {
                "none" => mode.name().to_owned(),
                reason => format!("{mode}: {reason}"),
            },
            hardware_id: HARDWARE,
            values: vec![
                pair("mode", mode.name()),
                pair("reason", reason),
                pair("link", link.name()),
            ],
        })
    }

    fn board(&self) -> Option<DiagnosticStatus> {
        let report = self.status?;
        let pilot = self.pilot.as_ref();
        let lost = pilot.is_some_and(|pilot| pilot.link != LinkPhase::Ready);
        let mode = self.board.map(|(mode, _)| mode);
        let level = match mode {
            _ if lost => STALE,
            Some(BoardMode::Failsafe | BoardMode::EmergencyStopped) => ERROR,
            Some(BoardMode::Boot) => WARN,
            _ if report.stop_input_open || self.trouble => WARN,
            _ => OK,
        };
        let message = match mode {
            _ if lost => "no word from the board",
            Some(mode) => mode.name(),
            None => "no telemetry yet",
        };
        let mut values = Vec::new();
        if let Some((mode, cause)) = self.board {
            values.extend([pair("mode", mode.name()), pair("stop_cause", cause.name())]);
        }
        values.extend([
            pair("battery_V", &(f64::from(report.battery_mv) / 1_000.0)),
            pair("stop_input_open", &report.stop_input_open),
            pair("reset_cause", report.reset_cause.name()),
            pair(
                "configuration_hash",
                &format_args!("{:08x}", report.configuration_hash),
            ),
            pair("frames_received", &report.frames_received),
            pair("frames_damaged", &report.frames_damaged),
            pair("frames_dropped", &report.frames_dropped),
            pair("drives_refused", &report.drives_refused),
            pair("last_refusal", report.last_refusal.name()),
            pair("bytes_overrun", &report.bytes_overrun),
            pair("imu_errors", &report.imu_errors),
        ]);
        Some(DiagnosticStatus {
            level,
            name: "singletrack: board",
            message: message.to_owned(),
            hardware_id: HARDWARE,
            values,
        })
    }

    fn record(&self) -> DiagnosticStatus {
        let (level, message) = match self.dropped {
            0 => (OK, "complete".to_owned()),
            dropped => (WARN, format!("{dropped} entries are missing")),
        };
        DiagnosticStatus {
            level,
            name: "singletrack: record",
            message,
            hardware_id: HARDWARE,
            values: vec![pair("entries_dropped", &self.dropped)],
        }
    }
}

/// The counters of errors.
const fn troubles(status: &Status) -> [u16; 5] {
    [
        status.frames_damaged,
        status.frames_dropped,
        status.drives_refused,
        status.bytes_overrun,
        status.imu_errors,
    ]
}

fn pair(key: &'static str, value: &(impl ToString + ?Sized)) -> KeyValue {
    KeyValue {
        key,
        value: value.to_string(),
    }
}
