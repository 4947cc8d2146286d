//! `singletrackd --check`: what it prints, where, and its exit status.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Stdio},
};

const EXAMPLE: &str = include_str!("../singletrackd.example.toml");

/// Exit status, standard output and standard error of a check of the text.
fn check(folder: &Path, text: &str, arguments: &[&str]) -> (i32, String, String) {
    let path = folder.join("car.toml");
    fs::write(&path, text).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_singletrackd"))
        .args(["--check", "--config"])
        .arg(&path)
        .args(arguments)
        .output()
        .unwrap();
    (
        output.status.code().unwrap(),
        String::from_utf8(output.stdout).unwrap(),
        String::from_utf8(output.stderr).unwrap(),
    )
}

/// The example with folders that can be written to.
fn example(folder: &Path) -> String {
    let path = |name: &str| folder.join(name).display().to_string();
    // The two folders, in the order of the file.
    EXAMPLE
        .replacen(
            "#directory = \"/var/log/singletrackd\"",
            &format!("directory = {:?}", path("records")),
            1,
        )
        .replacen(
            "#directory = \"/var/lib/singletrackd\"",
            &format!("directory = {:?}", path("state")),
            1,
        )
        .replacen(
            "#path = \"/run/singletrackd/control.sock\"",
            &format!("path = {:?}", path("control.sock")),
            1,
        )
}

#[test]
fn what_was_left_as_in_the_example_is_warned_of_and_the_status_is_success() {
    let folder = tempfile::tempdir().unwrap();
    let (status, out, error) = check(folder.path(), &example(folder.path()), &[]);
    assert_eq!(status, 0, "{error}");
    assert!(out.contains("car.toml: good"), "{out}");
    assert!(
        out.contains("= 2.4 allows limits.max_speed_m_s up to "),
        "{out}"
    );
    assert!(
        out.contains("the car can drive its reference from: centre of mass at ("),
        "{out}"
    );
    let keys: Vec<_> = error
        .lines()
        .map(|line| {
            let finding = line.strip_prefix("singletrackd: warning: ").unwrap();
            finding.split(" is ").next().unwrap()
        })
        .collect();
    assert_eq!(
        keys,
        [
            "motion_capture.server",
            "vehicle",
            "fence.braking_m_s2",
            "board.servo",
            "board.esc",
            "board.speed"
        ]
    );
}

#[test]
fn folders_that_cannot_be_written_to_are_warned_of_by_key() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let good = example(folder.path());
    let of_file = |name: &str| file.join(name).display().to_string();
    for (key, old) in [
        ("record.directory", "records"),
        ("state.directory", "state"),
        ("socket.path", "control.sock"),
    ] {
        let here = folder.path().join(old).display().to_string();
        let (status, _, error) = check(folder.path(), &good.replace(&here, &of_file(old)), &[]);
        assert_eq!(status, 0, "{error}");
        let line = error.lines().find(|line| line.contains(key)).unwrap();
        assert!(line.contains("file is no folder"), "{line}");
        assert_eq!(error.lines().count(), 7, "{error}");
    }
}

#[test]
fn a_reference_that_cannot_be_driven_ends_with_status_1_key_value_and_fix() {
    let folder = tempfile::tempdir().unwrap();
    let text = example(folder.path()).replace("radius_m = 0.85", "radius_m = 0.6");
    let (status, out, error) = check(folder.path(), &text, &[]);
    assert_eq!((status, &*out), (1, ""));
    assert!(
        error.contains("impossible: reference.radius_m is 0.6: ")
            && error.contains("at least 0.78"),
        "{error}"
    );
}

#[test]
fn an_invalid_file_ends_with_status_2() {
    let folder = tempfile::tempdir().unwrap();
    let text = example(folder.path()).replace("radius_m = 0.85", "radius_m = -0.6");
    let (status, _, error) = check(folder.path(), &text, &[]);
    assert_eq!(status, 2);
    assert!(error.contains("radius"), "{error}");
}

#[test]
fn the_place_where_the_car_stands_is_judged() {
    let folder = tempfile::tempdir().unwrap();
    let text = example(folder.path());
    let (status, out, _) = check(folder.path(), &text, &["--start", "0.67,-0.45,69"]);
    assert_eq!(status, 0);
    assert!(out.contains("centre of mass at (0.67, -0.45) m"), "{out}");
    // It looks away from the reference and has to turn round at the side.
    let (status, _, error) = check(folder.path(), &text, &["--start", "-0.7,-0.7,200"]);
    assert_eq!(status, 1);
    assert!(
        error.contains("reference.start is nearest: from here") && error.contains("Carry it to ("),
        "{error}"
    );
    let (status, _, error) = check(folder.path(), &text, &["--start", "1,2"]);
    assert_eq!(status, 2);
    assert!(error.contains("X,Y,YAW"), "{error}");
}

/// The log of a daemon with `--arm`, up to the start of its control thread.
fn log_with_arm(folder: &Path, text: &str) -> Vec<String> {
    let path = folder.join("car.toml");
    fs::write(&path, text).unwrap();
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_singletrackd"))
        .args(["--arm", "--uncalibrated", "--config"])
        .arg(&path)
        .env("NO_COLOR", "1")
        .env_remove("NOTIFY_SOCKET")
        .env_remove("RUST_LOG")
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut log = Vec::new();
    for line in BufReader::new(daemon.stderr.take().unwrap()).lines() {
        log.push(line.unwrap());
        if log.last().unwrap().contains("control thread started") {
            break;
        }
    }
    daemon.kill().unwrap();
    daemon.wait().unwrap();
    log
}

#[test]
fn the_daemon_does_not_arm_by_itself_what_its_check_finds_impossible() {
    let folder = tempfile::tempdir().unwrap();
    let good = example(folder.path()).replace(
        "server = \"192.168.1.10\"",
        "server = \"127.0.0.1\"\ncommand_port = 9",
    );
    let refused = |log: &[String]| log.iter().any(|line| line.contains("--arm: not armed"));
    let log = log_with_arm(
        folder.path(),
        &good.replace("radius_m = 0.85", "radius_m = 0.6"),
    );
    assert!(refused(&log), "{log:?}");
    // The daemon runs: a client may set another reference.
    assert!(
        log.last().unwrap().contains("control thread started"),
        "{log:?}"
    );
    let log = log_with_arm(folder.path(), &good);
    assert!(!refused(&log), "{log:?}");
    assert!(
        log.last().unwrap().contains("control thread started"),
        "{log:?}"
    );
}
