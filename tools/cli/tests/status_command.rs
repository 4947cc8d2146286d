//! `singletrack status` against a daemon that answers as told.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    io::{BufRead, BufReader, Write},
    os::unix::net::{UnixListener, UnixStream},
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    thread,
    time::{Duration, Instant},
};

use crate::pty::OnTerminal;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use singletrack_api::SOCKET_VERSION;

/// What the daemon says of itself.
fn status() -> Value {
    json!({
        "state": {
            "topic": "state", "tick": 7, "t_s": 0.06, "time_ns": 1, "held": false,
            "mode": "idle", "reason": "requested", "preflight": "battery-low", "link": "ready",
            "speed_m_s": 0.0, "pose_age_s": 0.0084, "x_m": 0.1, "y_m": 0.2, "yaw_rad": 0.0,
            "steering_rad": 0.0, "commanded_speed_m_s": 0.0,
            "filtering": "none", "filtered_ticks": 0,
        },
        "board": {"mode": "neutral", "stop_cause": "disarmed", "battery_mv": 6100},
        "cameras": {"diagnosis": "good", "text": "poses arrive"},
        "configuration": {"number": 1}, "figures": {"ticks": 7}, "realtime": {},
        "of_a_newer_daemon": [1, 2],
    })
}

/// A daemon that answers questions, and gives this number of states.
struct Daemon {
    folder: tempfile::TempDir,
}

impl Daemon {
    fn start(states: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let listener = UnixListener::bind(folder.path().join("socket")).unwrap();
        thread::spawn(move || {
            for client in listener.incoming() {
                let client = client.unwrap();
                thread::spawn(move || serve(client, states));
            }
        });
        Self { folder }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("socket")
    }
}

fn serve(mut client: UnixStream, states: u32) {
    let reading = BufReader::new(client.try_clone().unwrap());
    for line in reading.lines() {
        let Ok(line) = line else { return };
        let asked: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(asked["version"], SOCKET_VERSION);
        if asked["command"] == "status" {
            let answer = json!({"version": SOCKET_VERSION, "ok": true, "status": status()});
            if writeln!(client, "{answer}").is_err() {
                return;
            }
            continue;
        }
        assert_eq!(asked["command"], "watch");
        assert_eq!(asked["topics"], json!(["state"]));
        writeln!(client, "{}", json!({"version": SOCKET_VERSION, "ok": true})).unwrap();
        let begun = Instant::now();
        for tick in 0..states {
            let state = json!({
                "topic": "state", "tick": tick, "mode": "driving", "reason": null,
                "drive_time_s": f64::from(tick) * 0.01, "pose_age_s": 0.012, "speed_m_s": 0.5,
                "x_m": 0.1, "y_m": 0.2, "yaw_rad": 1.0, "point_m": [0.3, 0.2],
                "reference_m": [0.3, 0.21], "commanded_speed_m_s": 0.5, "steering_rad": 0.1,
                "board_age_s": 0.004, "held": false, "link": "ready", "t_s": 1.0, "time_ns": 1,
                "filtering": "none", "filtered_ticks": 0,
            });
            if writeln!(client, "{state}").is_err() {
                return;
            }
            // Not later for those that were late.
            let next = Duration::from_millis(10) * (tick + 1);
            thread::sleep(next.saturating_sub(begun.elapsed()));
        }
        return;
    }
}

fn command(arguments: &[&str], socket: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_singletrack"));
    command
        .arg("status")
        .args(arguments)
        .arg("--socket")
        .arg(socket);
    command
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn a_person_gets_one_line_with_the_reason_and_what_to_do() {
    let daemon = Daemon::start(0);
    let output = command(&[], &daemon.path()).output().unwrap();
    assert!(output.status.success());
    let printed = text(&output.stdout);
    assert_eq!(printed.lines().count(), 1, "{printed}");
    assert!(
        printed.starts_with("idle: the battery is below"),
        "{printed}"
    );
    for part in [
        "(battery-low); pose 8 ms old, battery 6.10 V, link ready, speed 0.00 m/s",
        "To do: Charge it.",
    ] {
        assert!(printed.contains(part), "{part} is missing in {printed}");
    }
}

#[test]
fn a_program_gets_the_whole_status() {
    let daemon = Daemon::start(0);
    let output = command(&["--json"], &daemon.path()).output().unwrap();
    let printed: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(printed, status());
    // In lines, as before there was anything else.
    assert!(text(&output.stdout).lines().count() > 10);
}

#[test]
fn the_socket_may_come_from_the_environment_and_the_option_wins() {
    let daemon = Daemon::start(0);
    let run = |variable: &Path, arguments: &[&str]| -> Output {
        Command::new(env!("CARGO_BIN_EXE_singletrack"))
            .arg("status")
            .args(arguments)
            .env("SINGLETRACK_SOCKET", variable)
            .output()
            .unwrap()
    };
    let path = daemon.path();
    assert!(run(&path, &[]).status.success());
    let nowhere = Path::new("/nowhere/control.sock");
    assert!(
        run(nowhere, &["--socket", path.to_str().unwrap()])
            .status
            .success()
    );
    let output = run(nowhere, &[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("/nowhere/control.sock"));
    let output = run(Path::new(""), &[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("unset SINGLETRACK_SOCKET"));
}

#[test]
fn every_command_with_a_socket_takes_it_from_the_environment() {
    let help = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_singletrack"))
            .args(arguments)
            .arg("--help")
            .output()
            .unwrap();
        text(&output.stdout)
    };
    let mut counted = 0;
    for name in crate::command_line::commands() {
        let help = help(&[&name]);
        if help.contains("--socket") {
            counted += 1;
            // Lines are wrapped.
            let words: Vec<_> = help.split_whitespace().collect();
            let variable = "[env: SINGLETRACK_SOCKET]";
            assert!(words.join(" ").contains(variable), "{name}");
        }
    }
    assert!(counted >= 11, "only {counted} commands have --socket");
}

#[test]
fn without_a_terminal_the_watch_prints_lines_until_the_daemon_ends() {
    let daemon = Daemon::start(150);
    let output = command(&["--watch"], &daemon.path()).output().unwrap();
    // The daemon has gone.
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("lost the connection to the daemon"));
    let printed = text(&output.stdout);
    let lines: Vec<_> = printed.lines().collect();
    assert_eq!(lines.len(), 2, "{printed}");
    assert!(lines[0].starts_with("idle: "), "{printed}");
    // About a second after the first, of the 1.5 s that the daemon drives.
    let driven = lines[1].strip_prefix("driving ").unwrap();
    let driven: f64 = driven.split(' ').next().unwrap().parse().unwrap();
    assert!((0.5..1.5).contains(&driven), "{printed}");
    assert!(
        lines[1].contains("pose 12 ms old, battery 6.10 V"),
        "{printed}"
    );
    assert!(!printed.contains('\x1b'), "{printed:?}");
}

#[test]
fn a_closed_pipe_ends_the_watch_with_success() {
    let daemon = Daemon::start(100_000);
    let mut child = command(&["--watch"], &daemon.path())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    assert!(child.wait().unwrap().success());
}

const ENTER: &str = "\x1b[?1049h\x1b[?25l";
const LEAVE: &str = "\x1b[?25h\x1b[?1049l";

/// Watches on a terminal until `end`; returns what was printed after the picture.
fn watch_until(end: impl FnOnce(&mut OnTerminal)) -> String {
    let daemon = Daemon::start(100_000);
    let mut watch = OnTerminal::start(command(&["--watch"], &daemon.path()));
    watch.wait_for("mode      driving");
    watch.wait_for("10 mm from its reference");
    assert!(watch.is_raw());
    end(&mut watch);
    let (status, seen, is_raw) = watch.end();
    assert_eq!(status.code(), Some(0), "{seen:?}");
    assert!(!is_raw, "the terminal is not as it was");
    assert!(seen.starts_with(ENTER), "{seen:?}");
    let pictures = seen.matches("\x1b[H").count();
    assert!(pictures >= 2, "{pictures}");
    let (_, after) = seen.split_once(LEAVE).unwrap();
    after.to_owned()
}

#[test]
fn on_a_terminal_q_ends_the_watch_and_the_last_line_stays() {
    let after = watch_until(|watch| watch.press(b"q"));
    assert!(
        after.starts_with("driving ") && after.lines().count() == 1,
        "{after}"
    );
}

#[test]
fn on_a_terminal_an_interrupt_ends_the_watch_and_restores_it() {
    let after = watch_until(|watch| {
        let id = Pid::from_child(watch.child());
        kill_process(id, Signal::INT).unwrap();
    });
    assert!(after.starts_with("driving "), "{after}");
}

#[test]
fn a_terminal_that_can_not_move_its_cursor_gets_lines() {
    let daemon = Daemon::start(100_000);
    // The variable of the helper is replaced in the program itself.
    let mut shell = Command::new("env");
    shell
        .arg("TERM=dumb")
        .arg(env!("CARGO_BIN_EXE_singletrack"))
        .args(["status", "--watch", "--socket"])
        .arg(daemon.path());
    let mut watch = OnTerminal::start(shell);
    watch.wait_for("driving ");
    let id = Pid::from_child(watch.child());
    kill_process(id, Signal::INT).unwrap();
    let (status, seen, _) = watch.end();
    assert!(status.success() && !seen.contains('\x1b'), "{seen:?}");
}
