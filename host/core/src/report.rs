//! Reports of the control thread for record, log and figures.

use singletrack_link::{Counters, Event, State};
use singletrack_record::{Entry, LinkPhase, StatusRecord, TelemetryRecord};

use crate::proof::Proof;

/// A report of the control thread. Ticks have their own ring.
#[derive(Clone, Copy, Debug)]
pub enum Report {
    /// Telemetry of the board.
    Telemetry(TelemetryRecord),
    /// A status message of the board.
    Status(StatusRecord),
    /// A rare event of the link, for the log.
    Link {
        /// When it happened.
        time_ns: u64,
        /// The event.
        event: Event,
    },
    /// The counters so far.
    Counters(LineCounters),
    /// A configuration has been proved on a car.
    Proved {
        /// When the first metre had passed.
        time_ns: u64,
        /// The configuration and the car.
        proof: Proof,
    },
    /// A proof is void: a drive contradicted the configuration.
    Disproved {
        /// When the contradiction was found.
        time_ns: u64,
        /// The configuration and the car.
        proof: Proof,
    },
}

/// Counts of the line to the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineCounters {
    /// The counters of the session.
    pub link: Counters,
    /// Drive commands written to the port.
    pub drives_written: u64,
    /// Drive commands not written because the port was full or closed, or the board silent.
    pub drives_withheld: u64,
    /// Reports and ticks that found no room in their rings.
    pub reports_dropped: u64,
}

impl Report {
    /// The entry for the record; `None` for a report that is only logged or counted.
    #[must_use]
    pub const fn entry(self) -> Option<Entry> {
        match self {
            Self::Telemetry(record) => Some(Entry::Telemetry(record)),
            Self::Status(record) => Some(Entry::Status(record)),
            Self::Link { .. }
            | Self::Counters(_)
            | Self::Proved { .. }
            | Self::Disproved { .. } => None,
        }
    }

    /// The report of a link event that happened at `time_ns`.
    pub const fn of(time_ns: u64, event: &Event) -> Self {
        match *event {
            Event::Telemetry(record) => Self::Telemetry(TelemetryRecord {
                receive_time_ns: record.receive_time_ns,
                board_time_host_ns: record.board_time_host_ns,
                imu_time_host_ns: record.imu_time_host_ns,
                telemetry: record.telemetry,
            }),
            Event::Status(status) => Self::Status(StatusRecord {
                receive_time_ns: time_ns,
                status,
            }),
            event => Self::Link { time_ns, event },
        }
    }
}

/// The state of the session without its details, as the record has it.
#[must_use]
pub const fn link_phase(state: &State) -> LinkPhase {
    match state {
        State::Disconnected => LinkPhase::Disconnected,
        State::Greeting { .. } => LinkPhase::Greeting,
        State::VersionMismatch(_) => LinkPhase::VersionMismatch,
        State::Configuring => LinkPhase::Configuring,
        State::ConfigurationRefused { .. } => LinkPhase::ConfigurationRefused,
        State::Ready { .. } => LinkPhase::Ready,
    }
}
