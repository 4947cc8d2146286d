//! What the pilot is told of the link's events.

use singletrack_control::{InertialSample, Time};
use singletrack_link::{Event as LinkEvent, TimedTelemetry};
use singletrack_pilot::{BoardHealth, BoardSample, BoardState, Event, LinkState};
use singletrack_protocol::{
    BoardMode, RefusalReason, Request as BoardRequestKind, Status, StopCause,
};

/// The pilot's event for one of the link; none for what does not concern it. The motor's speed is
/// by the board's clock.
#[must_use]
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
