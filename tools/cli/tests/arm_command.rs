//! `singletrack arm` against a socket that answers as told. The suite with hardware in the loop
//! drives with it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    io::{BufRead, BufReader, Write},
    os::unix::net::UnixListener,
    path::Path,
    process::{Command, Output},
    thread,
};

/// The number of renewals after which the daemon gives its last answer.
const RENEWALS: usize = 2;

/// Runs the command against a daemon that gives `answers`, the last one after two renewals, and
/// then waits for the end of the connection; returns the output, and what the daemon was sent.
fn scripted(options: &[&str], answers: &'static [&str]) -> (Output, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control.sock");
    let listener = UnixListener::bind(&path).unwrap();
    let daemon = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
        let mut asked = vec![lines.next().unwrap().unwrap()];
        let (last, before) = answers.split_last().unwrap();
        for answer in before {
            writeln!(stream, "{answer}").unwrap();
        }
        asked.extend(lines.by_ref().take(RENEWALS).map(Result::unwrap));
        writeln!(stream, "{last}").unwrap();
        // What the client has sent by now is still read.
        stream.shutdown(std::net::Shutdown::Write).unwrap();
        asked.extend(lines.map_while(Result::ok));
        asked
    });
    let output = run(options, &path);
    (output, daemon.join().unwrap())
}

fn run(options: &[&str], socket: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("arm")
        .args(options)
        .arg("--socket")
        .arg(socket)
        .output()
        .unwrap()
}

#[test]
fn a_held_drive_is_renewed_and_the_exit_status_tells_how_it_ended() {
    for (ended, status) in [
        (
            r#"{"version":3,"ended":{"mode":"idle","reason":"requested"}}"#,
            0,
        ),
        (
            r#"{"version":3,"ended":{"mode":"ready","reason":"reference-finished"}}"#,
            0,
        ),
        (
            r#"{"version":3,"ended":{"mode":"idle","reason":"outside-fence"}}"#,
            3,
        ),
        (
            r#"{"version":3,"ended":{"mode":"fault","reason":"stop-not-obeyed"}}"#,
            3,
        ),
        (
            r#"{"version":3,"ok":false,"error":"can't arm: mode idle: no-pose"}"#,
            1,
        ),
    ] {
        let answers: &'static [&str] = Box::leak(Box::new([
            r#"{"version":3,"ok":true}"#,
            r#"{"version":3,"drive":{"mode":"driving","reason":null,"drive_time_s":0.2}}"#,
            ended,
        ]));
        let (output, asked) = scripted(&[], answers);
        assert_eq!(output.status.code(), Some(status), "{ended} {output:?}");
        assert_eq!(
            serde_json::from_str::<serde_json::Value>(&asked[0]).unwrap(),
            serde_json::json!({
                "version": 3, "command": "arm", "attendance": "hold",
            })
        );
        let renewals = asked.get(1..=RENEWALS).unwrap();
        assert!(
            renewals
                .iter()
                .all(|line| line.contains(r#""command":"hold""#)),
            "{asked:?}"
        );
    }
}

#[test]
fn a_lost_connection_is_an_error() {
    let (output, _) = scripted(&[], &[r#"{"version":3,"ok":true}"#]);
    assert_eq!(output.status.code(), Some(1));
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        error.contains("lost the connection to the daemon: it has ended")
            && error.contains("journalctl -u singletrackd"),
        "{error}"
    );
}

#[test]
fn options_that_contradict_each_other_are_refused() {
    for options in [
        &["--hold", "--unattended"][..],
        &["--for", "60s", "--unattended"],
        &["--for", "60s", "--hold"],
        &["--for", "0s"],
        &["--for", "soon"],
    ] {
        assert_eq!(run(options, Path::new("/nowhere")).status.code(), Some(2));
    }
}
