//! A short record with everything in it, and how the tool is run on it.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use singletrack_control::{
    Actuation, Estimate, PoseSample, Position, ReferencePoint, Time, Velocity,
};
use singletrack_mocap::{CaptureTimeSource, Observation, Pose, PoseState, RejectReason};
use singletrack_pilot::{DriveCommand, Event, Filtering, Mode, Reason};
use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, ResetCause, Sequence, Status, StopCause, Telemetry,
};
use singletrack_record::{
    ClockMapping, DriveWrite, Drops, Entry, Level, LinkPhase, Log, Meta, Recorder, StatusRecord,
    TelemetryRecord, TickRecord,
};

pub(crate) const START_NS: u64 = 120_000_000_000;

pub(crate) const START: ClockMapping = ClockMapping {
    monotonic_ns: START_NS,
    wall_ns: 1_780_000_000_000_000_000,
};

pub(crate) fn telemetry(index: u8) -> Entry {
    let time = START_NS + 10_000_000 * u64::from(index);
    Entry::Telemetry(TelemetryRecord {
        receive_time_ns: time + 4_100_000,
        board_time_host_ns: time,
        imu_time_host_ns: (index > 0).then_some(time - 1_200_000),
        telemetry: Telemetry {
            board_time_us: 10_000 * u32::from(index),
            mode: BoardMode::Driving,
            stop_cause: StopCause::None,
            last_sequence: Sequence(index),
            imu: if index > 0 {
                ImuState::Fresh
            } else {
                ImuState::Silent
            },
            imu_age_100us: 12,
            linear_acceleration_mm_s2: [15, -198, 3],
            angular_velocity_mrad_s: [0, 1, 500],
            attitude_q14: [16_384, 0, 0, -2],
            motor_speed_mm_s: 393,
            servo_us: 1_604,
            esc_us: 1_561,
        },
    })
}

pub(crate) fn driving_tick() -> TickRecord {
    let pose_time = Time(START_NS + 2_000_000);
    let now = START_NS + 10_000_000;
    let mut tick = standing_tick();
    tick.index = 1;
    tick.scheduled_ns = now;
    tick.start_ns = now + 61_000;
    tick.finish_ns = now + 94_000;
    tick.pilot_time = Time(now);
    tick.events.clear();
    tick.events
        .push(Event::Pose(PoseSample {
            capture: pose_time,
            receive: Time(now - 500_000),
            frame: 1201,
            position: Position::new(0.25, -0.5),
            yaw: 1.5,
        }))
        .unwrap();
    tick.output.mode = Mode::Driving;
    tick.output.reason = None;
    tick.output.held = false;
    tick.output.drive_time = Some(0.01);
    tick.output.estimate = Some(Estimate {
        time: Time(now),
        position: Position::new(0.25, -0.496),
        yaw: 0.1 + 0.2,
        yaw_rate: 0.5,
        sideslip: 1e-7,
        speed: 0.4,
        pose_time,
    });
    tick.output.reference = Some(ReferencePoint {
        position: Some(Position::new(1.0, 0.0)),
        velocity: Velocity::new(0.0, 0.5),
    });
    tick.output.point = Some(Position::new(0.7, 0.1));
    tick.output.point_velocity = Some(Velocity::new(0.3, -0.1));
    tick.output.actuation = Actuation {
        speed: 0.3974,
        steering: 0.3286,
        steering_rate: -0.02,
    };
    tick.output.command = Some(DriveCommand {
        rear_speed: 0.39,
        steering: 0.3286,
        pose_time,
        brake: false,
    });
    tick.drive = Some(DriveWrite {
        sequence: 7,
        written: true,
        time_ns: now + 92_000,
    });
    tick.link = LinkPhase::Ready;
    tick
}

pub(crate) fn standing_tick() -> TickRecord {
    TickRecord {
        index: 0,
        scheduled_ns: START_NS,
        start_ns: START_NS + 70_000,
        finish_ns: START_NS + 80_000,
        skipped: 0,
        pilot_time: Time(START_NS),
        events: [Event::ArmRefused].into_iter().collect(),
        events_dropped: 0,
        output: singletrack_pilot::Output {
            mode: Mode::Idle,
            reason: Some(Reason::NoPose),
            estimate: None,
            covariance: None,
            held: true,
            drive_time: None,
            reference: None,
            point: None,
            point_velocity: None,
            actuation: Actuation::default(),
            turning_round: false,
            looked_ahead: None,
            path: None,
            slowed_by: None,
            command: None,
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
        drive: None,
        link: LinkPhase::Greeting,
    }
}

pub(crate) fn entries() -> Vec<Entry> {
    let observation = |frame_number, state| {
        Entry::Pose(Observation {
            frame_number,
            receive_time_ns: START_NS + 9_500_000,
            state,
        })
    };
    vec![
        Entry::Log(Log {
            time_ns: START_NS,
            level: Level::Warning,
            text: "no real-time priority, \"best effort\"".to_owned(),
        }),
        Entry::Tick(standing_tick()),
        telemetry(0),
        Entry::Status(StatusRecord {
            receive_time_ns: START_NS + 5_000_000,
            status: Status {
                board_time_us: 4_000,
                configuration_hash: 0x1234_5678,
                reset_cause: ResetCause::PowerOn,
                stop_input_open: false,
                battery_mv: 7_412,
                frames_received: 100,
                frames_damaged: 1,
                drives_refused: 2,
                last_refusal: RefusalReason::Stale,
                frames_dropped: 0,
                bytes_overrun: 3,
                imu_errors: 0,
                supply_mv: 5_000,
                battery_open: false,
                power_on: false,
                edges_refused: 0,
                imu_calibration: 0xFF,
                imu_status: 5,
                imu_error: 0,
                imu_self_test: 0x0F,
            },
        }),
        observation(
            1201,
            PoseState::Valid(Pose {
                x_m: 0.25,
                y_m: -0.5,
                z_m: 0.1,
                yaw_rad: 1.5,
                tilt_rad: 0.001,
                roll_rad: 0.0,
                pitch_rad: 0.0,
                capture_time_ns: START_NS + 2_000_000,
                capture_uncertainty_ns: 80_000,
                capture_source: CaptureTimeSource::MidExposureEcho,
                receive_time_ns: START_NS + 9_500_000,
                frame_number: 1201,
                mean_error_m: 0.0002,
                reacquired: false,
            }),
        ),
        observation(1202, PoseState::Rejected(RejectReason::Jump)),
        Entry::Tick(driving_tick()),
        telemetry(1),
        Entry::Drops(Drops {
            time_ns: START_NS + 10_000_000,
            entries: 3,
        }),
    ]
}

pub(crate) fn recorder(folder: &Path) -> (Recorder, PathBuf) {
    let path = folder.join("drive.mcap");
    let meta = Meta {
        configuration: String::new(),
        software: BTreeMap::new(),
        protocol_version: 1,
        seed: None,
        start: START,
    };
    let mut recorder = Recorder::create(&path, &meta).unwrap();
    for entry in entries() {
        recorder.write(&entry).unwrap();
    }
    recorder.flush().unwrap();
    (recorder, path)
}

pub(crate) fn command(source: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_singletrack"));
    command.arg("dump").arg(source).args(arguments);
    command
}

pub(crate) fn dump(source: &Path, arguments: &[&str]) -> Output {
    command(source, arguments).output().unwrap()
}

pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Compares with the committed text; leaves what it should be where it can be
/// looked at.
pub(crate) fn assert_case(name: &str, printed: &str) {
    let now = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&now, printed).unwrap();
    let expected = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/dump_cases")
        .join(name);
    let expected = fs::read_to_string(expected).unwrap_or_default();
    assert_eq!(
        printed,
        expected,
        "{name}; it is now as in {}",
        now.display()
    );
}
