//! What `singletrack dump` prints, case by case, against committed text in
//! `dump_cases/`; and what it says when it can't.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    collections::BTreeMap,
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::Ipv4Addr,
    os::unix::net::UnixListener,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    thread,
};

use singletrack::simulated::{Drive, daemon_config};
use singletrack_control::{
    Actuation, DriveCommand, Estimate, Event, Mode, PoseSample, Position, Reason, ReferencePoint,
    Time, VehicleParameters, Velocity,
};
use singletrack_mocap::{CaptureTimeSource, Observation, Pose, PoseState, RejectReason};
use singletrack_protocol::{
    BoardMode, ImuState, RefusalReason, ResetCause, Sequence, Status, StopCause, Telemetry,
};
use singletrack_record::{
    ClockMapping, DriveWrite, Drops, Entry, Level, LinkPhase, Log, Meta, Recorder, StatusRecord,
    TelemetryRecord, TickRecord, part_path,
};
use singletrack_sim::{RealTimeConfig, RealTimeSimulator, UdpConfig};
use singletrackd::{
    Daemon, StartOptions,
    config::{LawKind, LawSection, OuterLoopSection, ReferenceSection},
};

const START_NS: u64 = 120_000_000_000;

fn telemetry(index: u8) -> Entry {
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

fn driving_tick() -> TickRecord {
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
    });
    tick.drive = Some(DriveWrite {
        sequence: 7,
        written: true,
        time_ns: now + 92_000,
    });
    tick.link = LinkPhase::Ready;
    tick
}

fn standing_tick() -> TickRecord {
    TickRecord {
        index: 0,
        scheduled_ns: START_NS,
        start_ns: START_NS + 70_000,
        finish_ns: START_NS + 80_000,
        skipped: 0,
        pilot_time: Time(START_NS),
        events: [Event::ArmRefused].into_iter().collect(),
        events_dropped: 0,
        output: singletrack_control::Output {
            mode: Mode::Idle,
            reason: Some(Reason::NoPose),
            estimate: None,
            held: true,
            drive_time: None,
            reference: None,
            point: None,
            point_velocity: None,
            actuation: Actuation::default(),
            turning_round: false,
            command: None,
            request: None,
        },
        drive: None,
        link: LinkPhase::Greeting,
    }
}

fn entries() -> Vec<Entry> {
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

fn recorder(folder: &Path) -> (Recorder, PathBuf) {
    let path = folder.join("drive.mcap");
    let meta = Meta {
        configuration: String::new(),
        software: BTreeMap::new(),
        protocol_version: 1,
        seed: None,
        start: ClockMapping {
            monotonic_ns: START_NS,
            wall_ns: 1_780_000_000_000_000_000,
        },
    };
    let mut recorder = Recorder::create(&path, &meta).unwrap();
    for entry in entries() {
        recorder.write(&entry).unwrap();
    }
    recorder.flush().unwrap();
    (recorder, path)
}

fn command(source: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_singletrack"));
    command.arg("dump").arg(source).args(arguments);
    command
}

fn dump(source: &Path, arguments: &[&str]) -> Output {
    command(source, arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Compares with the committed text; leaves what it should be where it can be
/// looked at.
fn assert_case(name: &str, printed: &str) {
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

#[test]
fn every_topic_is_printed_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    for topic in ["tick", "telemetry", "status", "pose", "log", "drops"] {
        for format in ["table", "json", "csv"] {
            let output = dump(&path, &["--topic", topic, "--format", format]);
            assert_eq!(text(&output.stderr), "");
            assert!(output.status.success());
            assert_case(&format!("{topic}.{format}"), &text(&output.stdout));
        }
    }
}

#[test]
fn chosen_fields_are_printed_in_the_order_given() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    for format in ["table", "json", "csv"] {
        let fields = "estimate.yaw_rad,index,estimate.sideslip_rad,events";
        let arguments = ["--topic=tick", "--format", format, "--fields", fields];
        let output = dump(&path, &arguments);
        assert_case(&format!("fields.{format}"), &text(&output.stdout));
    }
}

#[test]
fn without_a_terminal_telemetry_is_printed_as_csv() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    let output = dump(&path, &[]);
    assert_case("telemetry.csv", &text(&output.stdout));
}

#[test]
fn an_unfinished_record_is_found_printed_and_said_to_be_one() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    for source in [part_path(&path), path] {
        let output = dump(&source, &["--format", "json"]);
        assert!(output.status.success());
        assert_case("telemetry.json", &text(&output.stdout));
        let note = text(&output.stderr);
        assert!(note.contains("stops after 9 entries"), "{note}");
    }
    drop(recorder);
}

#[test]
fn a_record_being_written_is_followed_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let (mut recorder, path) = recorder(folder.path());
    let mut child = command(&path, &["--follow", "--fields=last_sequence"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut next = || lines.next().unwrap().unwrap();
    assert_eq!([next(), next(), next()], ["last_sequence", "0", "1"]);
    recorder.write(&telemetry(2)).unwrap();
    recorder.flush().unwrap();
    assert_eq!(next(), "2");
    recorder.finish().unwrap();
    assert!(lines.next().is_none());
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_closed_pipe_is_success() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.mcap");
    let (recorder, other) = recorder(folder.path());
    recorder.finish().unwrap();
    fs::rename(other, &path).unwrap();
    let (mut recorder, path) = self::recorder(folder.path());
    for index in 0..20_000_u32 {
        recorder.write(&telemetry(index as u8)).unwrap();
    }
    recorder.finish().unwrap();
    let mut child = command(&path, &["--format=json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Far more is printed than a pipe holds.
    let mut first = [0; 10];
    child.stdout.take().unwrap().read_exact(&mut first).unwrap();
    let output = child.wait_with_output().unwrap();
    assert_eq!(text(&output.stderr), "");
    assert!(output.status.success());
}

#[test]
fn errors_name_the_file_and_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let notes = folder.path().join("notes.txt");
    fs::write(&notes, "only some notes").unwrap();
    let pretended = folder.path().join("notes.mcap");
    fs::write(&pretended, "only some notes").unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    let missing = folder.path().join("missing.mcap");
    for (source, arguments, expected) in [
        (
            &notes,
            &[][..],
            "notes.txt holds no whole frame of the protocol in 15 bytes: name a capture",
        ),
        (
            &pretended,
            &[],
            "notes.mcap is not an MCAP file: name a record",
        ),
        (&missing, &[], "cannot open"),
        (&missing, &[], "missing.mcap"),
        (
            &path,
            &["--fields=yaw_rate"],
            "did you mean \"yaw_rate_mrad_s\"?",
        ),
        (
            &path,
            &["--fields=colour"],
            "telemetry has no field \"colour\"; its fields are receive_time_ns,",
        ),
        (
            &path,
            &["--topic=poses"],
            "there is no topic \"poses\": use tick, telemetry",
        ),
    ] {
        let output = dump(source, arguments);
        let error = text(&output.stderr);
        assert!(!output.status.success(), "{expected}");
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn what_the_daemon_sees_is_printed_as_a_record_of_it_would_be() {
    let folder = tempfile::tempdir().unwrap();
    for format in ["table", "json", "csv"] {
        let socket = folder.path().join(format!("{format}.sock"));
        let listener = UnixListener::bind(&socket).unwrap();
        let daemon = thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut request = String::new();
            BufReader::new(&stream).read_line(&mut request).unwrap();
            let mut lines = "{\"version\":1,\"ok\":true}\n\
                             {\"topic\":\"of a newer daemon\"}\n\
                             {\"version\":1,\"missed\":12}\n"
                .to_owned();
            for entry in entries() {
                entry.write_json(&mut lines);
                lines.push('\n');
            }
            stream.write_all(lines.as_bytes()).unwrap();
            request
        });
        let socket = socket.to_str().unwrap();
        let output = dump(
            Path::new("live"),
            &["--topic=tick", "--format", format, "--socket", socket],
        );
        assert!(output.status.success());
        let note = text(&output.stderr);
        assert!(note.contains("12 entries of all topics missed"), "{note}");
        assert_case(&format!("tick.{format}"), &text(&output.stdout));
        let asked: serde_json::Value = serde_json::from_str(&daemon.join().unwrap()).unwrap();
        assert_eq!(
            asked,
            serde_json::json!({"version": 1, "command": "watch", "topics": ["tick"]})
        );
    }
}

#[test]
fn a_running_daemon_tells_what_its_board_reports() {
    let folder = tempfile::tempdir().unwrap();
    let simulator = RealTimeSimulator::start(RealTimeConfig {
        pty_link: Some(folder.path().join("board")),
        udp: UdpConfig {
            interface: Ipv4Addr::LOCALHOST,
            // Any free ones.
            command_port: 0,
            data_port: 0,
        },
        ..RealTimeConfig::default()
    })
    .unwrap();
    let mut config = daemon_config(Drive {
        vehicle: VehicleParameters::paper(),
        law: LawSection {
            kind: LawKind::FrontPoint,
            point_distance_m: 0.35,
            front_axle_distance_m: VehicleParameters::paper().front_axle_distance_m,
        },
        outer_loop: OuterLoopSection::Proportional {
            gain_per_s: [1.0, 1.0],
            feed_forward: false,
        },
        reference: ReferenceSection::Circle {
            radius_m: 1.0,
            angular_velocity_rad_s: 0.5,
            centre_m: [0.0, 0.0],
        },
    });
    config.serial.port = simulator.pty_path().to_owned();
    config.motion_capture.command_port = simulator.command_address().port();
    config.motion_capture.data_port = simulator.data_address().port();
    config.record.enabled = false;
    config.socket.path = folder.path().join("control.sock");
    let socket = config.socket.path.clone();
    let daemon = Daemon::start(config, StartOptions::default()).unwrap();

    let mut child = command(
        Path::new("live"),
        &["--fields=board_time_us", "--format=csv", "--socket"],
    )
    .arg(&socket)
    .stdout(Stdio::piped())
    .spawn()
    .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut next = || lines.next().unwrap().unwrap();
    assert_eq!(next(), "board_time_us");
    let times = [next(), next(), next()].map(|time| time.parse::<u32>().unwrap());
    assert!(times.is_sorted_by(|a, b| a < b), "{times:?}");

    // The dump ends with the daemon.
    daemon.stop().unwrap();
    assert!(child.wait().unwrap().success());
    simulator.stop().unwrap();
}

#[test]
fn a_daemon_that_is_not_there_or_refuses_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("daemon.sock");
    let arguments = ["--socket", socket.to_str().unwrap()];
    let output = dump(Path::new("live"), &arguments);
    let error = text(&output.stderr);
    assert!(!output.status.success());
    assert!(error.contains("start singletrackd"), "{error}");

    let listener = UnixListener::bind(&socket).unwrap();
    let daemon = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        // Read before closing, or the answer is lost with the connection.
        BufReader::new(&stream)
            .read_line(&mut String::new())
            .unwrap();
        stream
            .write_all(b"{\"version\":1,\"ok\":false,\"error\":\"version 1 is too old\"}\n")
            .unwrap();
    });
    let output = dump(Path::new("live"), &arguments);
    daemon.join().unwrap();
    let error = text(&output.stderr);
    assert!(!output.status.success());
    assert!(error.contains("version 1 is too old"), "{error}");
}
