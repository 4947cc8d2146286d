//! `singletrack accept` with a socket that answers as told, and with a record.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    os::unix::net::UnixListener,
    path::Path,
    process::{Command, Output, Stdio},
    thread,
};

use serde_json::{Value, json};
use singletrack_scenario::simulate::{RunOptions, Scenario, simulate_with, virtual_drive_config};

const CONFIG: &str = include_str!("../../../host/daemon/singletrackd.example.toml");

/// Runs the command without a terminal.
fn accept(arguments: &[&str], paths: &[&Path]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("accept")
        .args(arguments)
        .args(paths)
        .stdin(Stdio::null())
        .output()
        .unwrap()
}

/// Accepts from a daemon with this calibration, which reads `config`; gives the output and what
/// the daemon was asked.
fn from_daemon(config: &Path, calibration: &Value, yes: bool) -> (Output, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("control.sock");
    let listener = UnixListener::bind(&socket).unwrap();
    let status = json!({
        "mode": "idle", "config_path": config, "calibration": calibration,
        "cameras": {"diagnosis": "good", "text": "poses arrive"},
        "configuration": {"number": 1}, "figures": {}, "realtime": {},
    });
    let daemon = thread::spawn(move || {
        let mut asked = Vec::new();
        loop {
            let (mut stream, _) = listener.accept().unwrap();
            let mut line = String::new();
            let mut reader = BufReader::new(stream.try_clone().unwrap());
            if reader.read_line(&mut line).unwrap() == 0 {
                return asked;
            }
            asked.push(
                serde_json::from_str::<Value>(&line).unwrap()["command"]
                    .as_str()
                    .unwrap()
                    .to_owned(),
            );
            writeln!(
                stream,
                "{}",
                json!({"version": 3, "ok": true, "status": status})
            )
            .unwrap();
        }
    });
    let mut arguments = vec!["--socket", socket.to_str().unwrap()];
    arguments.extend(yes.then_some("--yes"));
    let output = accept(&arguments, &[]);
    // A connection without a request is the end.
    drop(std::os::unix::net::UnixStream::connect(&socket).unwrap());
    (output, daemon.join().unwrap())
}

fn trim_is_off() -> Value {
    json!({
        "advice": ["the steering trim is 0.0525 +- 0.0005 rad more than configured"],
        "corrections": [
            {"key": "board.servo.centre_us", "configured": 1_500, "value": 1_458},
            {"key": "limits.max_steering_rad", "configured": 0.45, "value": 0.397},
        ],
    })
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The example as a file.
fn written(folder: &Path) -> std::path::PathBuf {
    let path = folder.join("car.toml");
    fs::write(&path, CONFIG).unwrap();
    path
}

#[test]
fn the_change_is_shown_and_written_only_when_it_is_agreed_to() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let (output, asked) = from_daemon(&path, &trim_is_off(), false);
    assert!(!output.status.success());
    let shown = text(&output.stdout) + &text(&output.stderr);
    assert!(
        shown.contains("singletrack accept") && shown.contains("+centre_us = 1458"),
        "{shown}"
    );
    assert!(text(&output.stderr).contains("--yes"));
    assert_eq!(fs::read_to_string(&path).unwrap(), CONFIG);
    assert_eq!(asked, ["status"]);

    let (output, asked) = from_daemon(&path, &trim_is_off(), true);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("has reloaded"));
    assert!(
        fs::read_to_string(&path)
            .unwrap()
            .contains("centre_us = 1458")
    );
    assert_eq!(asked, ["status", "reload"]);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);

    // Advice on what was configured before is no advice on this file.
    let (output, asked) = from_daemon(&path, &trim_is_off(), true);
    assert!(!output.status.success());
    let refused = text(&output.stderr);
    assert!(
        refused.contains("board.servo.centre_us is 1458, and was 1500"),
        "{refused}"
    );
    assert_eq!(asked, ["status"]);
}

#[test]
fn values_that_the_daemon_would_refuse_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let mut calibration = trim_is_off();
    calibration["corrections"][0]["value"] = json!(9_999);
    let (output, _) = from_daemon(&path, &calibration, true);
    assert!(!output.status.success());
    let refused = text(&output.stderr);
    assert!(refused.contains("centre_us"), "{refused}");
    assert_eq!(fs::read_to_string(&path).unwrap(), CONFIG);
}

#[test]
fn a_daemon_that_knows_nothing_or_no_fault_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = written(folder.path());
    let (output, _) = from_daemon(&path, &Value::Null, true);
    assert!(text(&output.stderr).contains("mode = \"advice\""));
    let (output, _) = from_daemon(&path, &json!({"advice": [], "corrections": []}), true);
    assert_eq!(text(&output.stdout), "the drives contradict no value\n");
    assert_eq!(fs::read_to_string(&path).unwrap(), CONFIG);
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn the_record_of_a_drive_says_what_to_write() {
        let folder = tempfile::tempdir().unwrap();
        let [record, path] = ["drive.mcap", "car.toml"].map(|name| folder.path().join(name));
        let eight = include_str!("../../scenarios/best/eight-6x3.toml");
        let run = format!("{eight}seed = 1\n[truth.cameras]\nbody_yaw_deg = 1.0\n");
        let scenario = Scenario::from_toml(&run, Path::new("scenario.toml")).unwrap();
        let (config, _) = virtual_drive_config(&scenario).unwrap();
        let options = RunOptions {
            record: Some(&record),
            ..RunOptions::default()
        };
        simulate_with(&scenario, options).unwrap();
        fs::write(&path, config.to_toml().unwrap()).unwrap();
        let paths = [&*record, "--config".as_ref(), &*path];
        let before = fs::read_to_string(&path).unwrap();
        let output = accept(&["--check"], &paths);
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert_eq!(fs::read_to_string(&path).unwrap(), before);
        let checked = text(&output.stdout);
        let row = checked.lines().find(|line| line.starts_with("body-yaw"));
        // The whole record and both halves find it.
        assert_eq!(row.unwrap().matches("+0.017").count(), 3, "{checked}");
        let output = accept(&["--yes"], &paths);
        assert!(output.status.success(), "{}", text(&output.stderr));
        let changed = singletrack_core::Config::read(&path).unwrap();
        let yaw_rad = changed.motion_capture.marker_yaw_rad;
        assert!((yaw_rad - 1.0_f64.to_radians()).abs() < 0.002, "{yaw_rad}");
        // A record needs the file that it is about.
        assert_eq!(accept(&[], &[&record]).status.code(), Some(2));
    }
}
