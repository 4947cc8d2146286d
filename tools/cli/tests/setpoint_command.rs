//! `singletrack set-reference` and `setpoint` against a daemon without a car.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    fs,
    io::Write,
    net::Ipv4Addr,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    time::{Duration, Instant},
};

use singletrack_core::{Config, config::ReferenceSection};
use singletrackd::{Daemon, StartOptions};
use tempfile::TempDir;

/// Takes set-points for as long as may be: a busy computer holds a program up for a third of a second,
/// and what is sent late is refused.
const EXTERNAL: ReferenceSection = ReferenceSection::External {
    setpoint_timeout_ms: 1_000,
};

/// A daemon that has neither board nor cameras.
struct Fixture {
    daemon: Daemon,
    socket: PathBuf,
    folder: TempDir,
}

fn start(reference: Option<ReferenceSection>) -> Fixture {
    let folder = tempfile::tempdir().unwrap();
    let example = include_str!("../../../host/daemon/singletrackd.example.toml");
    let mut config = Config::from_toml(example).unwrap();
    config.serial.port = folder.path().join("board");
    config.motion_capture.server = Ipv4Addr::LOCALHOST;
    config.motion_capture.command_port = Some(9);
    config.control.realtime_priority = 0;
    config.record.enabled = false;
    config.socket.path = folder.path().join("control.sock");
    if let Some(reference) = reference {
        config.reference = reference;
    }
    let socket = config.socket.path.clone();
    Fixture {
        daemon: Daemon::start(config, StartOptions::default()).unwrap(),
        socket,
        folder,
    }
}

fn singletrack(arguments: &[&str], socket: &Path, input: &str) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(arguments)
        .arg("--socket")
        .arg(socket)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // It may have ended before it has read everything.
    let _ = child.stdin.take().unwrap().write_all(input.as_bytes());
    child.wait_with_output().unwrap()
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

#[test]
fn a_reference_comes_into_force_with_waypoints_beside_its_file() {
    let fixture = start(None);
    let file = fixture.folder.path().join("way.toml");
    fs::write(
        &file,
        "[reference]\nkind = \"waypoints\"\nfile = \"way.csv\"\n",
    )
    .unwrap();
    let rows = "t_s,x_m,y_m\n0,0.0,0.0\n2,0.4,0.0\n4,0.4,0.4\n";
    fs::write(fixture.folder.path().join("way.csv"), rows).unwrap();
    let output = singletrack(
        &["set-reference", file.to_str().unwrap()],
        &fixture.socket,
        "",
    );
    assert_eq!(text(&output.stderr), "");
    assert_eq!(
        text(&output.stdout),
        "reference replaced: configuration 2 is in force\n"
    );
    assert_eq!(fixture.daemon.configuration().number, 2);
}

#[test]
fn a_reference_that_the_car_cannot_drive_comes_into_force_and_is_a_failure() {
    let fixture = start(None);
    let file = fixture.folder.path().join("far.toml");
    let far = "[reference]\nkind = \"circle\"\nradius_m = 0.8\nangular_velocity_rad_s = 0.4\n\
               centre_m = [9.0, 0.0]\n";
    fs::write(&file, far).unwrap();
    let output = singletrack(
        &["set-reference", file.to_str().unwrap()],
        &fixture.socket,
        "",
    );
    assert_eq!(output.status.code(), Some(1));
    let error = text(&output.stderr);
    assert!(
        error.starts_with("singletrack: impossible: fence.corners_m is"),
        "{error}"
    );
    assert_eq!(fixture.daemon.configuration().number, 2);
}

#[test]
fn a_file_that_is_not_a_reference_is_reported_with_the_reason() {
    let fixture = start(None);
    let file = fixture.folder.path().join("reference.toml");
    for (content, part) in [
        ("kind = \"circle\"\n", "must have a table [reference]"),
        ("[reference]\nkind = \"square\"\n", "square"),
        (
            "[reference]\nkind = \"cricle\"\n",
            "line 2: reference.kind = \"cricle\": it must be \"circle\", ",
        ),
        (
            "[reference]\nkind = \"cricle\"\n",
            "did you mean \"circle\"?",
        ),
        (
            "[reference]\nkind = \"circle\"\nradius_m = 0,85\n",
            "reference.radius_m = 0,85: write a number with a point: 0.85",
        ),
        (
            "[reference]\nkind = \"circle\"\nradius_m = \"x\"\n",
            "line 3: reference.radius_m = \"x\": it must be a number",
        ),
        ("[reference]\nkind = \"circle\"\n", "radius_m"),
        (
            "[reference]\nkind = \"external\"\n[limits]\n",
            "must have a table [reference]",
        ),
    ] {
        fs::write(&file, content).unwrap();
        let output = singletrack(
            &["set-reference", file.to_str().unwrap()],
            &fixture.socket,
            "",
        );
        assert!(!output.status.success());
        let error = text(&output.stderr);
        assert!(
            error.contains(part) && error.contains("reference.toml"),
            "{content}: {error}"
        );
    }
    assert_eq!(fixture.daemon.configuration().number, 1);
}

#[test]
fn set_points_are_streamed_without_a_word() {
    let fixture = start(Some(EXTERNAL));
    let input = "0.3 0.0\n\n{\"velocity_m_s\":[0.3,0.1]}\n".repeat(500);
    let output = singletrack(&["setpoint"], &fixture.socket, &input);
    assert_eq!(text(&output.stderr), "");
    assert_eq!(text(&output.stdout), "");
    assert!(output.status.success());
}

#[test]
fn a_set_point_of_the_options_is_renewed_for_its_time() {
    let fixture = start(Some(EXTERNAL));
    let way = fixture.folder.path().join("way.json");
    fs::write(
        &way,
        r#"[{"t_s":0,"position_m":[0,0]},{"t_s":1,"position_m":[1,0]}]"#,
    )
    .unwrap();
    let accepted = || fixture.daemon.snapshot().figures.setpoints.accepted;
    for options in [
        "--velocity -0.3 0 --for 0.2",
        "--velocity 0 0 --position 1 -1 --for 0.2",
        "--steering -0.1 --acceleration 0.5 --for 0.2",
        "--steering-rate 0.1 --speed -0.5 --for 0.2",
    ] {
        let before = accepted();
        let arguments: Vec<_> = ["setpoint"].into_iter().chain(options.split(' ')).collect();
        let output = singletrack(&arguments, &fixture.socket, "");
        assert_eq!(text(&output.stderr), "", "{options}");
        assert!(output.status.success());
        assert!(accepted() > before + 1, "{options}");
    }
    // The car does not drive: its trajectory waits at the first point.
    let mut child = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(["setpoint", "--trajectory"])
        .arg(&way)
        .arg("--socket")
        .arg(&fixture.socket)
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let before = accepted();
    let begun = Instant::now();
    while accepted() < before + 3 {
        assert!(begun.elapsed() < Duration::from_secs(20));
        if let Some(status) = child.try_wait().unwrap() {
            let output = child.wait_with_output().unwrap();
            panic!("it has ended with {status}: {}", text(&output.stderr));
        }
    }
    child.kill().unwrap();
    assert_eq!(text(&child.wait_with_output().unwrap().stderr), "");

    fs::write(&way, "t_s,x_m,y_m\n0,0,0\n0,1,0\n").unwrap();
    let file = way.to_str().unwrap();
    let output = singletrack(&["setpoint", "--trajectory", file], &fixture.socket, "");
    let error = text(&output.stderr);
    assert!(
        error.contains("way.json: point 2 is not later than the one before; put the points"),
        "{error}"
    );
}

#[test]
fn a_set_point_that_is_refused_is_an_error_in_the_daemons_words() {
    let fixture = start(None);
    let output = singletrack(&["setpoint"], &fixture.socket, "0.3 0.0\n");
    assert!(!output.status.success());
    let error = text(&output.stderr);
    assert!(
        error.contains("reference.kind is not \"external\""),
        "{error}"
    );

    let output = singletrack(&["setpoint"], &fixture.socket, "0.3\n");
    assert!(!output.status.success());
    let error = text(&output.stderr);
    assert!(
        error.contains("line 1: \"0.3\" is not a set-point"),
        "{error}"
    );
}
