//! The entries of a record.

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
    #[must_use]
    pub fn new_imu_time_ns(&self) -> Option<u64> {
        self.imu_time_host_ns
            .filter(|_| self.telemetry.imu == ImuState::Fresh)
    }

    /// Acceleration without gravity along the axes of the car (forward, left, up), in
    /// m/s².
    #[must_use]
    pub fn linear_acceleration_m_s2(&self) -> [f64; 3] {
        self.telemetry.linear_acceleration_mm_s2.map(thousandths)
    }

    /// Angular velocity about the axes of the car (forward, left, up), in rad/s.
    #[must_use]
    pub fn angular_velocity_rad_s(&self) -> [f64; 3] {
        self.telemetry.angular_velocity_mrad_s.map(thousandths)
    }
}

fn thousandths(value: i16) -> f64 {
    f64::from(value) / 1_000.0
}

/// Time from `start_ns` to `time_ns` of the same clock, in s; negative if `time_ns` is
/// the earlier one.
#[must_use]
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

singletrack_words::words! {
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
