//! The entries of a record, and its metadata.

use std::collections::BTreeMap;

use singletrack_mocap::Observation;
use singletrack_protocol::{ImuState, Status, Telemetry};

use crate::TickRecord;

/// One entry of a record.
///
/// It owns no memory on the heap, except in [`Entry::Log`] and
/// [`Entry::Configuration`]. All times are nanoseconds on the host's monotonic clock.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "the control thread must not allocate to report a tick"
)]
pub enum Entry {
    /// A control tick.
    Tick(TickRecord),
    /// A telemetry record of the board.
    Telemetry(TelemetryRecord),
    /// A status record of the board.
    Status(StatusRecord),
    /// The state of the car in one frame of the motion capture.
    Pose(Observation),
    /// A line of the log.
    Log(Log),
    /// A change of the configuration.
    Configuration(ConfigurationRecord),
    /// The count of entries that the record lacks.
    Drops(Drops),
}

/// A telemetry record of the board, with its times on the clock of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TelemetryRecord {
    /// When its last byte was received.
    pub receive_time_ns: u64,
    /// When the board made it.
    pub board_time_host_ns: u64,
    /// When the IMU took its sample; none if unknown.
    pub imu_time_host_ns: Option<u64>,
    /// The record as the board sent it.
    pub telemetry: Telemetry,
}

impl TelemetryRecord {
    /// When the IMU took its sample, if the record before did not carry the same sample
    /// and the time is known.
    pub fn new_imu_time_ns(&self) -> Option<u64> {
        self.imu_time_host_ns
            .filter(|_| self.telemetry.imu == ImuState::Fresh)
    }

    /// Acceleration without gravity along the axes of the car (forward, left, up), in
    /// m/s².
    pub fn linear_acceleration_m_s2(&self) -> [f64; 3] {
        self.telemetry.linear_acceleration_mm_s2.map(thousandths)
    }

    /// Angular velocity about the axes of the car (forward, left, up), in rad/s.
    pub fn angular_velocity_rad_s(&self) -> [f64; 3] {
        self.telemetry.angular_velocity_mrad_s.map(thousandths)
    }
}

fn thousandths(value: i16) -> f64 {
    f64::from(value) / 1_000.0
}

/// Time from `start_ns` to `time_ns` of the same clock, in s; negative if `time_ns` is
/// the earlier one.
pub const fn seconds_since(start_ns: u64, time_ns: u64) -> f64 {
    time_ns.wrapping_sub(start_ns).cast_signed() as f64 * 1e-9
}

/// A status record of the board, with its time of reception.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StatusRecord {
    /// When its last byte was received.
    pub receive_time_ns: u64,
    /// The record as the board sent it.
    pub status: Status,
}

/// A line of the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Log {
    /// When it was logged.
    pub time_ns: u64,
    /// Its severity.
    pub level: Level,
    /// Its text.
    pub text: String,
}

/// A configuration that came into force during the record. The first one is in the
/// [`crate::Meta`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfigurationRecord {
    /// When the change was known, after the first tick with it.
    pub time_ns: u64,
    /// Its number in [`singletrack_pilot::Event::Reconfigured`].
    pub number: u32,
    /// The whole configuration, as TOML.
    pub toml: String,
}

singletrack_control::words! {
    /// The severity of a line of the log, with the numbers of ROS's own levels.
    #[derive(PartialOrd, Ord)]
    pub enum Level {
        /// Details for fault finding.
        Debug = 10 "debug",
        /// Normal operation.
        Info = 20 "info",
        /// A fault that the car can drive with.
        Warning = 30 "warning",
        /// A failure.
        Error = 40 "error",
    }
}

/// The count of entries that did not reach the record because the writer was behind.
/// Written whenever the count has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drops {
    /// When the count was taken.
    pub time_ns: u64,
    /// Entries lost since the record began.
    pub entries: u64,
}

/// The version of records that this crate writes and reads. It must match exactly.
pub const RECORD_VERSION: u32 = 14;

/// The circumstances under which a record was made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Meta {
    /// The configuration used, as TOML.
    pub configuration: String,
    /// Versions by component, such as `singletrackd`.
    pub software: BTreeMap<String, String>,
    /// Version of the protocol between the computers.
    pub protocol_version: u16,
    /// Seed of the simulation, if there was one.
    pub seed: Option<u64>,
    /// The clocks when the record began.
    pub start: ClockMapping,
}

/// One moment on two clocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClockMapping {
    /// On the host's monotonic clock, in ns.
    pub monotonic_ns: u64,
    /// On the wall clock, in ns since 1970.
    pub wall_ns: u64,
}

impl ClockMapping {
    /// The mapping of a drive in virtual time, which has no time of day: 2000-01-01.
    pub const VIRTUAL: Self = Self {
        monotonic_ns: 0,
        wall_ns: 946_684_800_000_000_000,
    };

    /// The time of a wall clock that was not set since, at `monotonic_ns`.
    pub const fn wall_ns_at(&self, monotonic_ns: u64) -> u64 {
        if monotonic_ns >= self.monotonic_ns {
            self.wall_ns
                .saturating_add(monotonic_ns - self.monotonic_ns)
        } else {
            self.wall_ns
                .saturating_sub(self.monotonic_ns - monotonic_ns)
        }
    }
}
