//! What the controller reports: events of the link, and entries for record and status.

use singletrack_control::{InertialSample, Time};
use singletrack_link::{Counters, Event as LinkEvent, State, TimedTelemetry};
use singletrack_pilot::{BoardHealth, BoardSample, BoardState, Event, LinkState};
use singletrack_protocol::{
    BoardMode, RefusalReason, Request as BoardRequestKind, Status, StopCause,
};
use singletrack_record::{Entry, LinkPhase, StatusRecord, TelemetryRecord};

use crate::run::proof::Proof;

/// The pilot's event for one of the link; none for what does not concern it. The motor's speed is
/// by the board's clock.
pub fn pilot_event(event: &LinkEvent) -> Option<Event> {
    Some(match event {
        LinkEvent::Telemetry(record) => Event::Board(board_sample(record)),
        LinkEvent::ConfigurationAccepted { .. } => Event::Link(LinkState::Ready),
        LinkEvent::VersionMismatch(_) => Event::Link(LinkState::VersionDiffers),
        LinkEvent::ConfigurationRefused {
            reason: RefusalReason::EmergencyStopLatched,
            ..
        } => Event::Link(LinkState::EmergencyStopped),
        LinkEvent::ConfigurationRefused { .. } => Event::Link(LinkState::ConfigurationRefused),
        LinkEvent::BoardRestarted { .. } | LinkEvent::Lost { .. } => Event::Link(LinkState::Down),
        LinkEvent::Status(status) => Event::Health(BoardHealth {
            // What a floating input shows is no battery.
            battery_mv: if status.battery_open {
                0
            } else {
                status.battery_mv
            },
            stop_input_open: status.stop_input_open,
            battery_open: status.battery_open,
            imu_fault: imu_fault(status),
        }),
        LinkEvent::Refused {
            request: BoardRequestKind::Arm,
            ..
        } => Event::ArmRefused,
        LinkEvent::Connected { .. }
        | LinkEvent::Identified { .. }
        | LinkEvent::Acknowledged { .. }
        | LinkEvent::Refused { .. }
        | LinkEvent::Unanswered { .. }
        | LinkEvent::StopConfirmed { .. } => return None,
    })
}

/// Whether the IMU's registers report an error. A self-test of zero has not been read yet.
const fn imu_fault(status: &Status) -> bool {
    /// `SYS_STATUS` of a system error.
    const ERROR: u8 = 1;
    /// Accelerometer, gyro and controller; the magnetometer is not used.
    const PASSED: u8 = 0b1101;
    status.imu_status == ERROR
        || (status.imu_self_test != 0 && status.imu_self_test & PASSED != PASSED)
}

/// Converts telemetry to SI units.
fn board_sample(record: &TimedTelemetry) -> BoardSample {
    let telemetry = &record.telemetry;
    let milli = |value: i16| f64::from(value) / 1000.0;
    let [forward, left, _] = telemetry.linear_acceleration_mm_s2.map(milli);
    let [_, _, yaw_rate] = telemetry.angular_velocity_mrad_s.map(milli);
    BoardSample {
        time: Time(record.board_time_host_ns),
        inertial: record
            .imu_time_host_ns
            .filter(|_| record.has_fresh_imu_sample())
            .map(|time| InertialSample {
                time: Time(time),
                yaw_rate,
                forward_acceleration: forward,
                left_acceleration: left,
            }),
        motor_speed: milli(telemetry.motor_speed_mm_s),
        state: match telemetry.mode {
            BoardMode::Boot => BoardState::Booting,
            BoardMode::Neutral => BoardState::Neutral,
            BoardMode::Armed => BoardState::Armed,
            BoardMode::Driving => BoardState::Driving,
            BoardMode::Failsafe => BoardState::Failsafe,
            BoardMode::EmergencyStopped if telemetry.stop_cause == StopCause::RunsAtNeutral => {
                BoardState::RunsAtNeutral
            }
            BoardMode::EmergencyStopped => BoardState::EmergencyStopped,
            BoardMode::PoweringUp => BoardState::PoweringUp,
            BoardMode::Jogging => BoardState::Jogging,
        },
    }
}

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
        event: LinkEvent,
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
    pub const fn of(time_ns: u64, event: &LinkEvent) -> Self {
        match *event {
            LinkEvent::Telemetry(record) => Self::Telemetry(TelemetryRecord {
                receive_time_ns: record.receive_time_ns,
                board_time_host_ns: record.board_time_host_ns,
                imu_time_host_ns: record.imu_time_host_ns,
                telemetry: record.telemetry,
            }),
            LinkEvent::Status(status) => Self::Status(StatusRecord {
                receive_time_ns: time_ns,
                status,
            }),
            event => Self::Link { time_ns, event },
        }
    }
}

/// The state of the session without its details, as the record has it.
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
