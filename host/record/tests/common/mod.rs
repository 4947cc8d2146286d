//! Entries of every kind.

#![allow(dead_code, reason = "not every test needs everything")]

use std::{collections::BTreeMap, path::Path};

use proptest::prelude::*;
use singletrack_control::{
    Actuation, Covariance, Estimate, PoseSample, Position, ReferencePoint, Time, Velocity,
};
use singletrack_mocap::{Binding, CaptureTimeSource, Observation, Pose, PoseState, RejectReason};
use singletrack_pilot::{
    BoardSample, BoardState, DriveCommand, Event, Filtering, Mode, Output, PoseMissing, Reason,
};
use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, ResetCause, Sequence, Status, StopCause, Telemetry,
};
use singletrack_record::{
    ClockMapping, DriveWrite, Drops, Entry, Level, LinkPhase, Log, Meta, Recorder, StatusRecord,
    TelemetryRecord, TickRecord,
};

pub(crate) fn meta() -> Meta {
    Meta {
        configuration: "# the paper's circle\n[control]\nperiod_ms = 10\n".to_owned(),
        software: BTreeMap::from([("singletrackd".to_owned(), "0.1.0".to_owned())]),
        protocol_version: 1,
        seed: Some(u64::MAX),
        start: ClockMapping {
            monotonic_ns: 5_000_000_000,
            wall_ns: 1_780_000_000_000_000_000,
        },
    }
}

/// Writes a finished record.
pub(crate) fn record(path: &Path, entries: &[Entry]) {
    let mut recorder = Recorder::create(path, &meta()).unwrap();
    for entry in entries {
        recorder.write(entry).unwrap();
    }
    recorder.finish().unwrap();
}

pub(crate) fn log(time_ns: u64) -> Entry {
    Entry::Log(Log {
        time_ns,
        level: Level::Info,
        text: format!("line {time_ns}"),
    })
}

fn float() -> impl Strategy<Value = f64> {
    // The tests compare with `==`; event.rs compares the bits of NaN.
    any::<f64>().prop_filter("a number", |float| !float.is_nan())
}

fn position() -> impl Strategy<Value = Position> {
    (float(), float()).prop_map(|(x, y)| Position::new(x, y))
}

fn velocity() -> impl Strategy<Value = Velocity> {
    (float(), float()).prop_map(|(x, y)| Velocity::new(x, y))
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        (any::<[u64; 2]>(), any::<i32>(), position(), float()).prop_map(
            |([capture, receive], frame, position, yaw)| Event::Pose(PoseSample {
                capture: Time(capture),
                receive: Time(receive),
                frame,
                position,
                yaw,
            })
        ),
        (any::<u64>(), float()).prop_map(|(time, motor_speed)| Event::Board(BoardSample {
            time: Time(time),
            inertial: None,
            motor_speed,
            state: BoardState::Failsafe,
        })),
        Just(Event::PoseMissing(PoseMissing::Stale)),
        Just(Event::ArmRefused),
    ]
}

fn estimate() -> impl Strategy<Value = Estimate> {
    (
        any::<[u64; 2]>(),
        position(),
        [float(), float(), float(), float()],
    )
        .prop_map(
            |([time, pose_time], position, [yaw, yaw_rate, sideslip, speed])| Estimate {
                time: Time(time),
                position,
                yaw,
                yaw_rate,
                sideslip,
                speed,
                pose_time: Time(pose_time),
            },
        )
}

fn output() -> impl Strategy<Value = Output> {
    use prop::{option::of, sample::select};
    (
        select(vec![Mode::Driving, Mode::Fault, Mode::Arming]),
        of(select(vec![Reason::LawSingular, Reason::Moving])),
        of(estimate()),
        any::<[bool; 2]>(),
        of(float()),
        of((of(position()), velocity())),
        (of(position()), of(velocity())),
        [float(), float(), float()],
        of((float(), float(), any::<u64>())),
    )
        .prop_map(
            |(
                mode,
                reason,
                estimate,
                [held, turning_round],
                drive_time,
                reference,
                (point, point_velocity),
                [speed, steering, steering_rate],
                command,
            )| Output {
                mode,
                reason,
                estimate,
                covariance: estimate.map(|it| Covariance {
                    pose: [it.yaw, it.speed, 0.1, it.sideslip, 0.2, it.yaw_rate],
                    twist: [it.speed, 0.3, it.yaw, 0.4, it.sideslip, 0.5],
                }),
                held,
                drive_time,
                reference: reference
                    .map(|(position, velocity)| ReferencePoint { position, velocity }),
                point,
                point_velocity,
                actuation: Actuation {
                    speed,
                    steering,
                    steering_rate,
                },
                turning_round,
                looked_ahead: None,
                path: None,
                slowed_by: None,
                command: command.map(|(rear_speed, steering, pose_time)| DriveCommand {
                    rear_speed,
                    steering,
                    pose_time: Time(pose_time),
                    brake: false,
                }),
                request: None,
                proved: false,
                disproved: false,
                braking_measured: None,
                setpoint_refused: None,
                filtering: Filtering::None,
                filtered_ticks: 0,
                tuned: None,
                setpoint: None,
                preflight: None,
                jog: None,
            },
        )
}

fn tick() -> impl Strategy<Value = TickRecord> {
    (
        any::<[u64; 5]>(),
        any::<[u32; 2]>(),
        prop::collection::vec(event(), 0..=singletrack_record::MAX_EVENTS),
        output(),
        prop::option::of((any::<u8>(), any::<bool>(), any::<u64>())),
    )
        .prop_map(
            |(
                [index, scheduled_ns, start_ns, finish_ns, pilot_time],
                [skipped, events_dropped],
                events,
                output,
                drive,
            )| TickRecord {
                index,
                scheduled_ns,
                start_ns,
                finish_ns,
                skipped,
                pilot_time: Time(pilot_time),
                events: events.into_iter().collect(),
                events_dropped,
                output,
                drive: drive.map(|(sequence, written, time_ns)| DriveWrite {
                    sequence,
                    written,
                    time_ns,
                }),
                link: LinkPhase::ConfigurationRefused,
            },
        )
}

fn telemetry() -> impl Strategy<Value = TelemetryRecord> {
    (
        any::<([u64; 2], Option<u64>, u32)>(),
        any::<([u8; 2], [i16; 3], [i16; 3], [i16; 4], i16, [u16; 2])>(),
    )
        .prop_map(
            |(
                ([receive_time_ns, board_time_host_ns], imu_time_host_ns, board_time_us),
                ([sequence, imu_age_100us], linear, angular, attitude_q14, speed, [servo, esc]),
            )| TelemetryRecord {
                receive_time_ns,
                board_time_host_ns,
                imu_time_host_ns,
                telemetry: Telemetry {
                    board_time_us,
                    mode: BoardMode::EmergencyStopped,
                    stop_cause: StopCause::HostRestarted,
                    last_sequence: Sequence(sequence),
                    imu: ImuState::Repeated,
                    imu_age_100us,
                    linear_acceleration_mm_s2: linear,
                    angular_velocity_mrad_s: angular,
                    attitude_q14,
                    motor_speed_mm_s: speed,
                    servo_us: servo,
                    esc_us: esc,
                },
            },
        )
}

fn status() -> impl Strategy<Value = StatusRecord> {
    any::<(u64, u32, u32, bool, [u16; 9])>().prop_map(
        |(receive_time_ns, board_time_us, configuration_hash, stop_input_open, counts)| {
            let [
                battery_mv,
                frames_received,
                frames_damaged,
                drives_refused,
                frames_dropped,
                bytes_overrun,
                imu_errors,
                supply_mv,
                edges_refused,
            ] = counts;
            StatusRecord {
                receive_time_ns,
                status: Status {
                    board_time_us,
                    configuration_hash,
                    reset_cause: ResetCause::BrownOut,
                    stop_input_open,
                    battery_mv,
                    frames_received,
                    frames_damaged,
                    drives_refused,
                    last_refusal: RefusalReason::VersionDiffers,
                    frames_dropped,
                    bytes_overrun,
                    imu_errors,
                    supply_mv,
                    battery_open: !stop_input_open,
                    power_on: stop_input_open,
                    edges_refused,
                    imu_calibration: battery_mv as u8,
                    imu_status: frames_received as u8,
                    imu_error: frames_damaged as u8,
                    imu_self_test: drives_refused as u8,
                },
            }
        },
    )
}

fn pose_state() -> impl Strategy<Value = PoseState> {
    prop_oneof![
        prop::sample::select(vec![
            PoseState::NoFrames,
            PoseState::Untracked,
            PoseState::Absent,
            PoseState::Rejected(RejectReason::Jump),
            PoseState::LockedOut(RejectReason::NotFinite),
            PoseState::Unbound(Binding::Unresolved),
            PoseState::Unbound(Binding::Missing),
            PoseState::Unbound(Binding::Ambiguous { count: 3 }),
            PoseState::Unbound(Binding::Bound { id: -4 }),
        ]),
        any::<u64>().prop_map(|silent_ns| PoseState::Stale { silent_ns }),
        (
            [float(), float(), float(), float(), float(), float()],
            any::<[u64; 3]>(),
            any::<(i32, bool)>(),
        )
            .prop_map(|(floats, times, (frame_number, reacquired))| {
                let [x_m, y_m, z_m, yaw_rad, tilt_rad, mean_error_m] = floats;
                let [capture_time_ns, capture_uncertainty_ns, receive_time_ns] = times;
                PoseState::Valid(Pose {
                    x_m,
                    y_m,
                    z_m,
                    yaw_rad,
                    tilt_rad,
                    roll_rad: 0.0,
                    pitch_rad: 0.0,
                    capture_time_ns,
                    capture_uncertainty_ns,
                    capture_source: CaptureTimeSource::FrameTimestamp,
                    receive_time_ns,
                    frame_number,
                    mean_error_m,
                    reacquired,
                })
            }),
    ]
}

/// An entry of any kind.
pub(crate) fn entry() -> impl Strategy<Value = Entry> {
    prop_oneof![
        tick().prop_map(Entry::Tick),
        telemetry().prop_map(Entry::Telemetry),
        status().prop_map(Entry::Status),
        (any::<i32>(), any::<u64>(), pose_state()).prop_map(
            |(frame_number, receive_time_ns, state)| Entry::Pose(Observation {
                frame_number,
                receive_time_ns,
                state,
            })
        ),
        (any::<u64>(), any::<String>()).prop_map(|(time_ns, text)| Entry::Log(Log {
            time_ns,
            level: Level::Warning,
            text,
        })),
        any::<[u64; 2]>().prop_map(|[time_ns, entries]| Entry::Drops(Drops { time_ns, entries })),
    ]
}
