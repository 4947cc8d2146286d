//! Everything that a record can hold.

use singletrack_mocap::Observation;
use singletrack_protocol::{Status, Telemetry};

use crate::TickRecord;

/// One line of a record.
///
/// Without an allocation, except in [`Entry::Log`] and
/// [`Entry::Configuration`]. All times are nanoseconds on
/// the host's monotonic clock.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "the control thread must not allocate to tell what it did"
)]
pub enum Entry {
    /// A control tick.
    Tick(TickRecord),
    /// A telemetry record of the board.
    Telemetry(TelemetryRecord),
    /// A status record of the board.
    Status(StatusRecord),
    /// What one frame of the motion capture said of the car.
    Pose(Observation),
    /// A line of the log.
    Log(Log),
    /// The configuration changes.
    Configuration(ConfigurationRecord),
    /// What the record does not hold.
    Drops(Drops),
}

/// A telemetry record in host time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TelemetryRecord {
    /// When its last byte was received.
    pub receive_time_ns: u64,
    /// When the board made it.
    pub board_time_host_ns: u64,
    /// When the IMU took its sample; none if that cannot be told.
    pub imu_time_host_ns: Option<u64>,
    /// What the board said.
    pub telemetry: Telemetry,
}

/// A status record in host time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StatusRecord {
    /// When its last byte was received.
    pub receive_time_ns: u64,
    /// What the board said.
    pub status: Status,
}

/// A line of the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Log {
    /// When it was logged.
    pub time_ns: u64,
    /// How much it matters.
    pub level: Level,
    /// What it says.
    pub text: String,
}

/// Which configuration is in force; that of the start is in the [`crate::Meta`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfigurationRecord {
    /// When that was known, after the tick that took it over.
    pub time_ns: u64,
    /// The number that [`singletrack_control::Event::Reconfigured`] names it by.
    pub number: u32,
    /// The whole of it, as TOML.
    pub toml: String,
}

/// How much a line of the log matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// For whoever looks for a fault.
    Debug,
    /// The normal course of things.
    Info,
    /// Something is not as it should be; the car can do without.
    Warning,
    /// Something failed.
    Error,
}

impl Level {
    /// The word for this value in status, log, record and documentation.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Error => "error",
        }
    }
}

/// Entries that were made and did not reach the record, because the writer was
/// behind. Written whenever the count has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drops {
    /// When the count was taken.
    pub time_ns: u64,
    /// How many since the record began.
    pub entries: u64,
}
