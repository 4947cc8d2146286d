//! What the running daemon sees.

use std::{
    io::{BufRead, BufReader, Write},
    net::Ipv4Addr,
    os::unix::net::UnixListener,
    path::Path,
    process::Stdio,
    thread,
};

use singletrack_core::config::{ReferenceSection, Start};
use singletrack_record::{ClockMapping, Encoder};
use singletrack_scenario::simulated::{Drive, daemon_config};
use singletrack_sim::{RealTimeConfig, RealTimeSimulator, UdpConfig};
use singletrackd::{Daemon, StartOptions};

use crate::fixture::{assert_case, command, dump, entries, text};

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
            let begun = "{\"version\":3,\"ok\":true,\"clocks\":{\"monotonic_ns\":1,\"wall_ns\":2}}\n\
                         {\"topic\":\"of a newer daemon\",\"bytes\":0}\n\
                         {\"version\":3,\"missed\":12}\n";
            let mut bytes = begun.as_bytes().to_vec();
            let mut encoder = Encoder::new(ClockMapping {
                monotonic_ns: 1,
                wall_ns: 2,
            });
            for entry in entries() {
                for message in encoder.encode(&entry).unwrap() {
                    let (topic, length) = (message.channel.topic(), message.bytes.len());
                    bytes.extend(format!("{{\"topic\":\"{topic}\",\"bytes\":{length}}}\n").bytes());
                    bytes.extend(message.bytes);
                }
            }
            stream.write_all(&bytes).unwrap();
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
            serde_json::json!({"version": 3, "command": "messages", "topics": ["/singletrack/tick"]})
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
    let mut config = daemon_config(Drive::following(ReferenceSection::Circle {
        radius_m: 1.0,
        angular_velocity_rad_s: 0.5,
        centre_m: [0.0, 0.0],
        start: Start::Beginning,
    }));
    config.serial.port = simulator.pty_path.to_owned();
    config.motion_capture.command_port = Some(simulator.command_address.port());
    config.motion_capture.data_port = simulator.data_address.port();
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

#[test]
fn a_daemon_that_ends_before_its_answer_is_said_to_have_ended() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("control.sock");
    let listener = UnixListener::bind(&socket).unwrap();
    let daemon = thread::spawn(move || {
        let (stream, _) = listener.accept().unwrap();
        let mut request = String::new();
        BufReader::new(&stream).read_line(&mut request).unwrap();
    });
    let output = dump(Path::new("live"), &["--socket", socket.to_str().unwrap()]);
    daemon.join().unwrap();
    let error = text(&output.stderr);
    assert!(
        error.contains("lost the connection to the daemon: it has ended"),
        "{error}"
    );
}
