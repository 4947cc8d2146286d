//! `singletrack disarm|stop` against a socket that answers as told.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    io::{BufRead, BufReader, Write},
    os::unix::net::UnixListener,
    process::{Command, Output, Stdio},
    thread,
};

/// Runs a command against a daemon that gives one answer; returns the command's
/// output and what the daemon was asked.
fn ask(command: &str, answer: &'static str) -> (Output, String) {
    ask_into(command, answer, Stdio::piped())
}

fn ask_into(command: &str, answer: &'static str, stdout: Stdio) -> (Output, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control.sock");
    let listener = UnixListener::bind(&path).unwrap();
    let daemon = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut line = String::new();
        BufReader::new(stream.try_clone().unwrap())
            .read_line(&mut line)
            .unwrap();
        writeln!(stream, "{answer}").unwrap();
        line
    });
    let output = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg(command)
        .arg("--socket")
        .arg(&path)
        .stdout(stdout)
        .output()
        .unwrap();
    (output, daemon.join().unwrap())
}

#[test]
fn each_command_is_one_line_of_the_sockets_protocol() {
    for command in ["disarm", "stop"] {
        let (output, asked) = ask(command, r#"{"version":3,"ok":true}"#);
        assert!(output.status.success());
        let asked: serde_json::Value = serde_json::from_str(&asked).unwrap();
        assert_eq!(asked, serde_json::json!({"version": 3, "command": command}));
    }
}

#[test]
fn what_was_done_is_said_in_words() {
    for (command, words) in [
        ("disarm", "disarming: the car slows down and stops\n"),
        ("stop", "stopped: neutral until the board is reset\n"),
    ] {
        let (output, _) = ask(command, r#"{"version":3,"ok":true}"#);
        assert_eq!(String::from_utf8(output.stdout).unwrap(), words);
    }
}

#[test]
fn a_disarm_prints_the_note_of_the_daemon() {
    let (output, _) = ask(
        "disarm",
        r#"{"version":3,"ok":true,"note":"still stopped"}"#,
    );
    assert_eq!(String::from_utf8(output.stdout).unwrap(), "still stopped\n");
}

#[test]
fn a_reader_that_has_gone_is_success() {
    let answer = r#"{"version":3,"ok":true}"#;
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let (output, _) = ask_into("disarm", answer, writer.into());
    assert_eq!(String::from_utf8(output.stderr).unwrap(), "");
    assert!(output.status.success());
}

#[test]
fn a_refusal_is_an_error_in_the_daemons_words() {
    let (output, _) = ask(
        "arm",
        r#"{"version":3,"ok":false,"error":"not ready: no-pose"}"#,
    );
    assert!(!output.status.success());
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("not ready: no-pose")
    );
}

#[test]
fn a_daemon_that_is_not_there_is_named() {
    let output = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(["arm", "--socket", "/nowhere/control.sock"])
        .output()
        .unwrap();
    assert!(!output.status.success());
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("/nowhere/control.sock") && error.contains("singletrackd"));
}

#[test]
fn the_doctor_asks_the_daemon_of_its_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control.sock");
    let listener = UnixListener::bind(&path).unwrap();
    let daemon = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut line = String::new();
        BufReader::new(&stream).read_line(&mut line).unwrap();
        let answer = r#"{"version":3,"ok":false,"error":"it is this daemon"}"#;
        writeln!(stream, "{answer}").unwrap();
    });
    let config = folder.path().join("singletrackd.toml");
    let example = include_str!("../../../host/daemon/singletrackd.example.toml");
    let socket = format!("[socket]\npath = \"{}\"", path.display());
    assert!(example.contains("\n[socket]\n"));
    std::fs::write(&config, example.replacen("[socket]", &socket, 1)).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(["doctor", "--config"])
        .arg(&config)
        .env_remove("SINGLETRACK_SOCKET")
        .output()
        .unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("it is this daemon"), "{error}");
    daemon.join().unwrap();
}
