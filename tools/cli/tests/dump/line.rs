//! The serial line: a port, or captures of its bytes, whole and broken.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Child, Stdio},
    thread,
    time::Duration,
};

use serde_json::Value;
use singletrack_protocol::{
    Acknowledgement, BoardMode, Hello, ImuState, Refusal, RefusalReason, Request, ResetCause,
    Sequence, Status, StopCause, Telemetry, ToHost, VERSION,
};
use singletrack_sim::{Pty, SimulationConfig, World};

use crate::fixture::{assert_case, command, dump, text};

fn telemetry(board_time_us: u32) -> Vec<u8> {
    encoded(&ToHost::Telemetry(Telemetry {
        board_time_us,
        mode: BoardMode::Driving,
        stop_cause: StopCause::None,
        last_sequence: Sequence(7),
        imu: ImuState::Fresh,
        imu_age_100us: 12,
        linear_acceleration_mm_s2: [15, -198, 3],
        angular_velocity_mrad_s: [0, 1, 500],
        attitude_q14: [16_384, 0, 0, -2],
        motor_speed_mm_s: 393,
        servo_us: 1_604,
        esc_us: 1_561,
    }))
}

fn status(board_time_us: u32, frames_damaged: u16) -> Vec<u8> {
    encoded(&ToHost::Status(Status {
        board_time_us,
        configuration_hash: 0x1234_5678,
        reset_cause: ResetCause::External,
        stop_input_open: false,
        battery_mv: 7_412,
        frames_received: 100,
        frames_damaged,
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
    }))
}

fn hello(protocol_version: u16) -> Vec<u8> {
    encoded(&ToHost::Hello(Hello {
        protocol_version,
        software_version: [0, 1, 0],
        nonce: 0xc0de,
    }))
}

fn encoded(message: &ToHost) -> Vec<u8> {
    message.encode().as_bytes().to_vec()
}

/// A frame of whatever, with a good check sum.
fn frame(packet: &[u8]) -> Vec<u8> {
    let mut crc = 0xffff_u16;
    for byte in packet {
        crc ^= u16::from(*byte);
        for _ in 0..8 {
            crc = (crc >> 1) ^ if crc & 1 == 1 { 0x8408 } else { 0 };
        }
    }
    let mut stuffed = Vec::new();
    let whole = [packet, &(!crc).to_le_bytes()].concat();
    for block in whole.split(|byte| *byte == 0) {
        stuffed.push(block.len() as u8 + 1);
        stuffed.extend(block);
    }
    stuffed.push(0);
    stuffed
}

/// What a board sends that is reset by opening its port, on a bad line.
fn capture() -> Vec<u8> {
    let sequence = Sequence(9);
    let mut flipped = telemetry(30_000);
    flipped[20] ^= 0x10;
    let mut shortened = telemetry(40_000);
    shortened.drain(36..38);
    let half = telemetry(90_000)[..10].to_vec();
    [
        vec![0],
        hello(VERSION),
        telemetry(10_000),
        status(12_000, 1),
        encoded(&ToHost::Acknowledgement(Acknowledgement {
            request: Request::Arm,
            sequence,
            configuration_hash: 0x1234_5678,
        })),
        encoded(&ToHost::Refusal(Refusal {
            request: Request::Disarm,
            sequence,
            reason: RefusalReason::NotYetNeutral,
        })),
        vec![0, 0, 0],
        telemetry(20_000),
        flipped,
        shortened,
        vec![0x55; 70],
        vec![0],
        vec![2, 7, 0],
        frame(&[0x7f, 1, 2, 3]),
        frame(&[0x20, 1, 2, 3]),
        frame(&[0x23, 9, 9, 9]),
        telemetry(50_000),
        hello(VERSION + 1),
        telemetry(60_000),
        hello(VERSION),
        telemetry(70_000),
        status(72_000, 4),
        half,
    ]
    .concat()
}

#[test]
fn every_frame_of_a_capture_is_printed_and_what_is_broken_is_said_to_be_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.bin");
    fs::write(&path, capture()).unwrap();
    for format in ["table", "json", "csv"] {
        let output = dump(&path, &["--format", format]);
        assert_eq!(text(&output.stderr), "");
        assert!(output.status.success());
        assert_case(&format!("line.{format}"), &text(&output.stdout));
    }
}

#[test]
fn one_type_of_frame_has_its_own_columns() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.bin");
    fs::write(&path, capture()).unwrap();
    for topic in ["telemetry", "broken"] {
        for format in ["table", "csv"] {
            let output = dump(&path, &["--topic", topic, "--format", format]);
            assert_case(&format!("line_{topic}.{format}"), &text(&output.stdout));
        }
    }
}

#[test]
fn a_capture_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.bin");
    fs::write(&path, capture()).unwrap();
    for format in ["table", "json"] {
        let output = dump(&path, &["--stats", "--format", format]);
        let printed = text(&output.stdout).replace(path.to_str().unwrap(), "line.bin");
        assert_case(&format!("line_stats.{format}"), &printed);
    }
}

#[test]
fn a_capture_on_standard_input_is_printed_as_one_in_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.bin");
    fs::write(&path, capture()).unwrap();
    let mut child = command(Path::new("-"), &["--format=json"])
        .stdin(fs::File::open(&path).unwrap())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let printed = std::io::read_to_string(child.stdout.take().unwrap()).unwrap();
    assert!(child.wait().unwrap().success());
    assert_case("line.json", &printed);
}

#[test]
fn bytes_without_a_frame_are_an_error_after_what_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("noise.bin");
    fs::write(&path, [1, 2, 3, 0, 9, 9, 9, 9, 9]).unwrap();
    let output = dump(&path, &["--fields=offset,length,reason", "--topic=broken"]);
    assert!(!output.status.success());
    assert_eq!(
        text(&output.stdout),
        "offset,length,reason\n0,4,too-short\n4,5,unfinished\n"
    );
    let error = text(&output.stderr);
    assert!(
        error.contains("no whole frame of the protocol in 9 bytes"),
        "{error}"
    );
    fs::write(&path, []).unwrap();
    let output = dump(&path, &[]);
    assert!(text(&output.stderr).contains("in 0 bytes"));
}

#[test]
fn a_capture_holds_no_wall_time_but_the_time_of_the_board() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.bin");
    fs::write(&path, capture()).unwrap();
    let output = dump(&path, &["--from=2026-05-28T20:26:40Z"]);
    let error = text(&output.stderr);
    assert!(error.contains("line.bin holds no wall time"), "{error}");
    let arguments = ["--topic=telemetry", "--fields=board_time_us,time_s"];
    let output = dump(
        &path,
        &[&arguments[..], &["--from=0.005", "--to=0.05"]].concat(),
    );
    assert_eq!(
        text(&output.stdout),
        "board_time_us,time_s\n20000,0.01\n50000,0.04\n"
    );
}

/// So many seconds of a simulated board from its start.
fn simulated_board(seconds: u64) -> Vec<u8> {
    let mut world = World::new(SimulationConfig::default()).unwrap();
    let mut bytes = Vec::new();
    for ms in 1..=1_000 * seconds {
        world.advance_to(1_000 * ms);
        world.host_read(&mut bytes);
    }
    bytes
}

fn rows(path: &Path, arguments: &[&str]) -> Vec<Value> {
    let output = dump(path, &[&["--format=json"], arguments].concat());
    text(&output.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn the_frames_of_the_simulated_board_are_found_around_every_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.bin");
    let mut bytes = simulated_board(10);
    fs::write(&path, &bytes).unwrap();
    let whole = rows(&path, &[]);
    assert!(whole.len() > 1_000, "{}", whole.len());
    assert!(whole.iter().all(|row| row["topic"] != "broken"));
    let extent = |row: &Value| {
        let offset = row["offset"].as_u64().unwrap() as usize;
        offset..offset + row["length"].as_u64().unwrap() as usize
    };

    // One bit in every hundredth frame or so; not of an end, which joins two frames.
    let damaged: Vec<_> = (500..bytes.len())
        .step_by(4_001)
        .map(|at| if bytes[at] == 0 { at + 1 } else { at })
        .collect();
    for at in &damaged {
        bytes[*at] ^= 0x04;
    }
    fs::write(&path, &bytes).unwrap();
    let found = rows(&path, &[]);
    let hit = |row: &&Value| damaged.iter().any(|at| extent(row).contains(at));
    let untouched: Vec<_> = whole.iter().filter(|row| !hit(row)).collect();
    let good: Vec<_> = found
        .iter()
        .filter(|row| row["topic"] != "broken")
        .collect();
    assert_eq!(good, untouched);
    let broken: Vec<_> = found
        .iter()
        .filter(|row| row["topic"] == "broken")
        .collect();
    assert!(broken.len() >= damaged.len());
    for at in damaged {
        assert!(
            broken.iter().any(|row| extent(row).contains(&at)),
            "{at} is not said to be broken"
        );
    }
}

/// A dump of a serial port, once it listens.
fn listening(port: &Path, arguments: &[&str]) -> (Child, impl FnMut() -> Option<String> + use<>) {
    let mut child = command(port, arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    (child, move || lines.next().map(Result::unwrap))
}

#[test]
fn a_serial_port_is_listened_to_and_never_written_to() {
    let pty = Pty::open(None).unwrap();
    let (child, mut next) = listening(pty.path(), &["--format=csv", "--fields=topic_is_none"]);
    // The words are checked before the port is opened.
    assert_eq!(next(), None);
    let output = child.wait_with_output().unwrap();
    assert!(text(&output.stderr).contains("no field \"topic_is_none\""));

    let fields = "--fields=offset,length,board_time_us,reason";
    let (child, mut next) = listening(pty.path(), &["--format=csv", fields]);
    assert_eq!(next().unwrap(), "topic,offset,length,board_time_us,reason");
    let mut bytes = telemetry(10_000);
    assert_eq!(pty.write(&bytes).unwrap(), bytes.len());
    assert_eq!(next().unwrap(), "telemetry,0,40,10000,");
    bytes[5] ^= 1;
    assert_eq!(pty.write(&bytes).unwrap(), bytes.len());
    assert_eq!(next().unwrap(), "broken,40,40,,check-sum");
    assert_eq!(pty.read(&mut [0; 100]).unwrap(), 0);
    drop(pty);
    assert_eq!(next(), None);
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let note = text(&output.stderr);
    assert!(note.contains("the line hung up"), "{note}");
}

#[test]
fn a_serial_port_is_counted_for_as_long_as_asked() {
    let pty = Pty::open(None).unwrap();
    let child = command(pty.path(), &["--stats", "--for=1500ms", "--format=json"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    // From outside it is not visible when it has opened the port.
    thread::sleep(Duration::from_millis(700));
    for index in [1, 2, 5] {
        let bytes = telemetry(10_000 * index);
        assert_eq!(pty.write(&bytes).unwrap(), bytes.len());
    }
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["line"]["telemetry_lost"], 2);
    assert_eq!(report["line"]["bytes"], 120);
}

#[test]
fn a_capture_that_grows_is_followed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("line.bin");
    let mut file = fs::File::create(&path).unwrap();
    file.write_all(&telemetry(10_000)).unwrap();
    let arguments = [
        "--follow",
        "--topic=telemetry",
        "--fields=board_time_us",
        "--format=csv",
    ];
    let (mut child, mut next) = listening(&path, &arguments);
    assert_eq!(next().unwrap(), "board_time_us");
    assert_eq!(next().unwrap(), "10000");
    let more = telemetry(20_000);
    file.write_all(&more[..7]).unwrap();
    file.write_all(&more[7..]).unwrap();
    assert_eq!(next().unwrap(), "20000");
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_port_that_is_not_there_is_named_with_what_to_do() {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(["dump", "--serial", "/dev/singletrack-that-is-not-there"])
        .output()
        .unwrap();
    let error = text(&output.stderr);
    assert!(!output.status.success());
    assert!(
        error.contains("no such device; plug the board in"),
        "{error}"
    );
    let output = dump(Path::new("/dev/null"), &[]);
    let error = text(&output.stderr);
    assert!(!output.status.success());
    assert!(error.contains("is it the board's serial port"), "{error}");
}
