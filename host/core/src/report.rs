//! What the control thread tells those who keep the records.

use singletrack_link::{Counters, Event, State, TimedTelemetry};
use singletrack_protocol::Status;
use singletrack_record::{Entry, LinkPhase, StatusRecord, TelemetryRecord};

/// Beside the ticks, which have a ring of their own.
#[derive(Clone, Copy, Debug)]
pub enum Report {
    /// The board reported.
    Telemetry(TelemetryRecord),
    /// The board reported on itself.
    Status(StatusRecord),
    /// Something worth a line in the log.
    Link {
        /// When.
        time_ns: u64,
        /// What.
        event: Event,
    },
    /// What was counted so far.
    Counters(LineCounters),
}

/// What happened on the way to and from the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LineCounters {
    /// By the session.
    pub link: Counters,
    /// Drive commands that were written.
    pub drives_written: u64,
    /// Drive commands that were not, because the line was stuck, silent or closed.
    pub drives_withheld: u64,
    /// Reports and ticks that found no room on their way to the records.
    pub reports_dropped: u64,
}

impl Report {
    /// What a record holds of it; none for what is only logged or counted.
    #[must_use]
    pub const fn entry(self) -> Option<Entry> {
        match self {
            Self::Telemetry(record) => Some(Entry::Telemetry(record)),
            Self::Status(record) => Some(Entry::Status(record)),
            Self::Link { .. } | Self::Counters(_) => None,
        }
    }

    /// What an event of the link is to the records.
    pub const fn of(time_ns: u64, event: &Event) -> Self {
        match *event {
            Event::Telemetry(record) => Self::telemetry(&record),
            Event::Status(status) => Self::status(time_ns, status),
            event => Self::Link { time_ns, event },
        }
    }

    const fn telemetry(record: &TimedTelemetry) -> Self {
        Self::Telemetry(TelemetryRecord {
            receive_time_ns: record.receive_time_ns,
            board_time_host_ns: record.board_time_host_ns,
            imu_time_host_ns: record.imu_time_host_ns,
            telemetry: record.telemetry,
        })
    }

    const fn status(receive_time_ns: u64, status: Status) -> Self {
        Self::Status(StatusRecord {
            receive_time_ns,
            status,
        })
    }
}

/// Where the session stands, by name.
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
