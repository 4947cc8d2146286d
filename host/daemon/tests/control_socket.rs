//! The control socket of a daemon without board and cameras.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_api::{MessageStream, Received};
use singletrack_core::{Config, config::ReferenceSection};
use singletrack_pilot::Mode;
use singletrackd::{Daemon, StartOptions};
use tempfile::TempDir;

use crate::common;

pub(crate) struct Client {
    write: UnixStream,
    read: BufReader<UnixStream>,
}

impl Client {
    pub(crate) fn connect(path: &Path) -> Self {
        let write = UnixStream::connect(path).unwrap();
        write
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let read = BufReader::new(write.try_clone().unwrap());
        Self { write, read }
    }

    pub(crate) fn line(&mut self) -> Value {
        let mut line = String::new();
        self.read.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap()
    }

    pub(crate) fn ask(&mut self, line: &str) -> Value {
        writeln!(self.write, "{line}").unwrap();
        self.line()
    }
}

fn start() -> (Daemon, PathBuf, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control.sock");
    (
        Daemon::start(config(folder.path(), &path), StartOptions::default()).unwrap(),
        path,
        folder,
    )
}

pub(crate) fn config(folder: &Path, socket: &Path) -> Config {
    let mut config = common::config(folder);
    socket.clone_into(&mut config.socket.path);
    config
}

#[test]
fn the_status_has_mode_reason_and_figures() {
    let (daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    let status = loop {
        let answer = client.ask(r#"{"version":3,"command":"status"}"#);
        assert_eq!(answer["ok"], true);
        assert_eq!(answer["version"], 3);
        if answer["status"]["figures"]["ticks"].as_u64() > Some(3) {
            break answer["status"].clone();
        }
    };
    assert_eq!(status["state"]["mode"], "disconnected");
    assert_eq!(status["state"]["reason"], "link-down");
    assert_eq!(status["state"]["link"], "disconnected");
    assert_eq!(status["realtime"]["fifo_priority"], Value::Null);
    assert_eq!(status["state"]["x_m"], Value::Null);
    assert!(status["figures"]["lateness_us"]["p99"].is_number());
    daemon.stop().unwrap();
    assert!(!path.exists());
}

#[test]
fn an_arm_without_a_board_is_refused_with_the_reason() {
    let (daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    let answer = client.ask(r#"{"version":3,"command":"arm","attendance":"hold"}"#);
    assert_eq!(answer["ok"], false);
    assert!(
        answer["error"]
            .as_str()
            .unwrap()
            .contains("mode disconnected"),
        "{answer}"
    );
    for command in ["disarm", "stop"] {
        let answer = client.ask(&json!({"version": 3, "command": command}).to_string());
        // No mode: it would be the one before the request.
        assert_eq!(answer, json!({"version": 3, "ok": true}), "{command}");
    }
    while daemon.snapshot().mode() != Mode::Fault {
        std::thread::yield_now();
    }
    let answer = client.ask(r#"{"version":3,"command":"disarm"}"#);
    assert_eq!(answer["ok"], true);
    let note = answer["note"].as_str().unwrap();
    assert!(note.contains("stays stopped until it is reset"), "{note}");
    daemon.stop().unwrap();
}

#[test]
fn an_invalid_line_is_answered_and_the_connection_stays_open() {
    let (daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    for line in [
        "",
        "arm",
        "{}",
        r#"{"version":9,"command":"arm"}"#,
        "\u{1f600}",
    ] {
        let answer = client.ask(line);
        assert_eq!(answer["ok"], false, "{line}");
        assert!(answer["error"].is_string());
    }
    for length in [16_384, 20_000, 1_000_000] {
        let answer = client.ask(&"x".repeat(length));
        assert!(answer["error"].as_str().unwrap().contains("16384"));
    }
    assert_eq!(
        client.ask(r#"{"version":3,"command":"status"}"#)["ok"],
        true
    );
    daemon.stop().unwrap();
}

#[test]
fn a_watcher_gets_every_tick() {
    let (daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    let answer = client.ask(r#"{"version":3,"command":"watch","topics":["tick"]}"#);
    assert_eq!(answer["ok"], true);
    let first = client.line();
    assert_eq!(first["topic"], "tick");
    let second = client.line();
    assert_eq!(
        second["tick"].as_u64().unwrap(),
        first["tick"].as_u64().unwrap() + 1
    );
    daemon.stop().unwrap();
}

#[test]
fn watchers_that_disconnect_free_their_slots() {
    let (_daemon, path, _folder) = start();
    for _ in 0..200 {
        let mut client = Client::connect(&path);
        // The topic has no entries: the daemon must detect the end of the connection.
        let answer = client.ask(r#"{"version":3,"command":"watch","topics":["drops"]}"#);
        assert_eq!(answer["ok"], true, "{answer}");
    }
}

#[test]
fn the_configuration_in_force_is_given_as_text() {
    let (_daemon, path, folder) = start();
    let mut client = Client::connect(&path);
    let answer = client.ask(r#"{"version":3,"command":"configuration"}"#);
    assert_eq!(
        (&answer["ok"], &answer["configuration"]),
        (&json!(true), &json!(1))
    );
    let text = answer["toml"].as_str().unwrap();
    assert_eq!(
        Config::from_toml(text).unwrap(),
        config(folder.path(), &path)
    );
    let reference = json!({"kind": "circle", "radius_m": 0.7, "angular_velocity_rad_s": 0.4});
    let line = json!({"version": 3, "command": "set-reference", "reference": reference});
    assert_eq!(client.ask(&line.to_string())["configuration"], 2);
    let answer = client.ask(r#"{"version":3,"command":"configuration"}"#);
    assert_eq!(answer["configuration"], 2);
    assert!(
        answer["toml"]
            .as_str()
            .unwrap()
            .contains("radius_m = 0.7\n")
    );
}

#[test]
fn watchers_leave_places_for_those_who_command() {
    let (_daemon, path, _folder) = start();
    let streams = [
        r#"{"version":3,"command":"watch","topics":["drops"]}"#,
        r#"{"version":3,"command":"watch","topics":["state"]}"#,
        r#"{"version":3,"command":"messages","topics":["/odom"]}"#,
    ];
    let mut watchers: Vec<_> = (0..24)
        .map(|index| {
            let mut client = Client::connect(&path);
            assert_eq!(client.ask(streams[index % 3])["ok"], true);
            client
        })
        .collect();
    for stream in streams {
        let refused = Client::connect(&path).ask(stream);
        assert_eq!(refused["ok"], false, "{refused}");
        let why = refused["error"].as_str().unwrap();
        assert!(why.contains("24 clients watch"), "{why}");
    }
    let mut operators = Vec::new();
    common::wait_for(
        "eight places, after those who were refused have left",
        || {
            let mut client = Client::connect(&path);
            if client.ask(r#"{"version":3,"command":"status"}"#)["ok"] == true {
                operators.push(client);
            }
            operators.len() == 8
        },
    );
    drop(operators);
    watchers.pop();
    common::wait_for("the place of the watcher that left", || {
        Client::connect(&path).ask(streams[0])["ok"] == true
    });
}

#[test]
fn a_stop_is_obeyed_when_every_slot_is_taken() {
    let (daemon, path, _folder) = start();
    let clients: Vec<_> = (0..32)
        .map(|_| {
            let mut client = Client::connect(&path);
            client.ask(r#"{"version":3,"command":"status"}"#);
            client
        })
        .collect();
    let refused = Client::connect(&path).ask(r#"{"version":3,"command":"status"}"#);
    assert_eq!(refused["ok"], false, "{refused}");
    // Connections that a client has leaked: beyond 64 the oldest are closed.
    let mut leaked: Vec<_> = (0..300).map(|_| Client::connect(&path)).collect();
    for client in leaked.iter_mut().take(300 - 64) {
        assert_eq!(client.line()["ok"], false);
    }
    let stopped = Client::connect(&path).ask(r#"{"version":3,"command":"stop"}"#);
    assert_eq!(stopped["ok"], true, "{stopped}");
    while daemon.snapshot().mode() != Mode::Fault {
        std::thread::yield_now();
    }
    drop(clients);
}

#[test]
fn two_daemons_do_not_share_a_socket() {
    let (daemon, path, folder) = start();
    let mut config = config(folder.path(), &path);
    config.record.enabled = false;
    let error = Daemon::start(config, StartOptions::default()).unwrap_err();
    assert!(error.contains("another singletrackd"), "{error}");
    assert!(path.exists());
    daemon.stop().unwrap();
}

#[test]
fn the_record_of_a_run_can_be_read() {
    let (daemon, _path, _folder) = start();
    while daemon.snapshot().figures.ticks < 5 {
        std::thread::sleep(Duration::from_millis(1));
    }
    let summary = daemon.stop().unwrap();
    let ticks = singletrack_record::Reader::open(&summary.record.unwrap())
        .unwrap()
        .only(&[singletrack_record::Topic::Tick])
        .map(Result::unwrap)
        .count();
    assert_eq!(ticks as u64, summary.figures.ticks);
}

const CIRCLE: &str = r#"{"version":3,"command":"set-reference","reference":
    {"kind":"circle","radius_m":0.8,"angular_velocity_rad_s":0.4}}"#;
const EXTERNAL: &str = r#"{"version":3,"command":"set-reference","reference":
    {"kind":"external"}}"#;

/// The text on one line.
fn line(text: &str) -> String {
    text.replace('\n', " ")
}

fn status(client: &mut Client) -> Value {
    client.ask(r#"{"version":3,"command":"status"}"#)["status"].clone()
}

#[test]
fn a_reference_is_set_while_the_car_stands_and_is_recorded() {
    let (daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    assert_eq!(
        status(&mut client)["configuration"],
        json!({"number": 1, "last_change": null})
    );
    let answer = client.ask(&line(CIRCLE));
    assert_eq!(
        answer,
        json!({"version": 3, "ok": true, "configuration": 2})
    );
    assert_eq!(
        status(&mut client)["configuration"],
        json!({"number": 2, "last_change": {"by": "set-reference", "error": null}})
    );
    let summary = daemon.stop().unwrap();
    let recorded = singletrack_record::Reader::open(&summary.record.unwrap())
        .unwrap()
        .only(&[singletrack_record::Topic::Configuration])
        .map(Result::unwrap)
        .map(|entry| match entry {
            singletrack_record::Entry::Configuration(record) => {
                let config = Config::from_toml(&record.toml).unwrap();
                (record.number, config.reference)
            }
            other => panic!("{other:?}"),
        })
        .collect::<Vec<_>>();
    assert!(
        matches!(
            recorded[..],
            [(2, ReferenceSection::Circle { radius_m: 0.8, .. })]
        ),
        "{recorded:?}"
    );
}

#[test]
fn a_reference_that_the_car_cannot_drive_is_in_force_with_a_warning() {
    let (_daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    let far = json!({
        "kind": "circle", "radius_m": 0.8, "angular_velocity_rad_s": 0.4, "centre_m": [9.0, 0.0],
    });
    let command = json!({"version": 3, "command": "set-reference", "reference": far});
    let answer = client.ask(&command.to_string());
    assert_eq!(
        (&answer["ok"], &answer["configuration"]),
        (&json!(true), &json!(2))
    );
    let warnings = answer["warnings"].as_array().unwrap();
    let [warning] = &warnings[..] else {
        panic!("{answer}");
    };
    let warning = warning.as_str().unwrap();
    // Without a board it is not known where the car stands.
    assert!(
        warning.starts_with("impossible: fence.corners_m is")
            && warning.contains("from every start inside it"),
        "{warning}"
    );
}

#[test]
fn an_invalid_reference_changes_nothing() {
    let (_daemon, path, folder) = start();
    let mut client = Client::connect(&path);
    let secret = folder.path().join("state/secret");
    std::fs::create_dir_all(secret.parent().unwrap()).unwrap();
    std::fs::write(&secret, "root:secret:1:2\n").unwrap();
    for (reference, part) in [
        (json!({"kind": "circle"}), "radius_m"),
        (
            json!({"kind": "circle", "radius_m": -1.0, "angular_velocity_rad_s": 0.5}),
            "reference",
        ),
        (
            json!({"kind": "waypoints", "file": "way.csv"}),
            "reference.file is way.csv: a daemon needs an absolute path",
        ),
        (
            json!({"kind": "waypoints", "file": "/dev/zero"}),
            "reference.file is /dev/zero: clients of the socket may name files in",
        ),
        (
            json!({"kind": "waypoints", "file": "/nowhere/way.csv"}),
            "/nowhere/way.csv",
        ),
        (
            json!({"kind": "waypoints", "file": secret}),
            "line 1 must name the columns",
        ),
    ] {
        let command = json!({"version": 3, "command": "set-reference", "reference": reference});
        let answer = client.ask(&command.to_string());
        assert_eq!(answer["ok"], false, "{reference}");
        let error = answer["error"].as_str().unwrap();
        assert!(error.contains(part), "{reference}: {error}");
        assert!(!error.contains("root"), "{error}");
        assert_eq!(status(&mut client)["configuration"]["number"], 1);
    }
}

#[test]
fn set_points_are_answered_only_when_they_have_no_effect() {
    let (_daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    let good = r#"{"version":3,"command":"setpoint","velocity_m_s":[0.3,0.0]}"#;
    let actuation = r#"{"version":3,"command":"setpoint","steering_rad":0.1,"speed_m_s":0.3}"#;
    let now_ns = singletrackd::monotonic_ns();
    let points: Vec<_> = (0..100)
        .map(|index: u32| {
            let x = f64::from(index) * 0.012_345_678_901_234_567;
            json!({
                "time_ns": now_ns + u64::from(index) * 100_000_000,
                "position_m": [x, -x], "velocity_m_s": [0.123_456_789_012_345_67, -x],
            })
        })
        .collect();
    let trajectory = json!({ "version": 3, "command": "setpoint", "trajectory": points });
    let trajectory = trajectory.to_string();

    for line in [good, actuation, &trajectory] {
        let answer = client.ask(line);
        let error = answer["error"].as_str().unwrap();
        assert!(error.contains("reference.kind is not"), "{error}");
        assert_eq!(answer["code"], "not-external");
        assert_eq!(answer["rejected"], true);
    }

    assert_eq!(client.ask(&line(EXTERNAL))["ok"], true);
    for _ in 0..300 {
        for line in [good, actuation, &trajectory] {
            writeln!(client.write, "{line}").unwrap();
        }
    }
    let mut reject = |keys: &str, word: &str| {
        let line = format!(r#"{{"version":3,"command":"setpoint",{keys}}}"#);
        let answer = client.ask(&line);
        assert_eq!(answer["ok"], false, "{keys}");
        assert_eq!(answer["code"], word, "{keys}: {}", answer["error"]);
    };
    let velocity = r#""velocity_m_s":[0.3,0.0]"#;
    reject(r#""velocity_m_s":[0.3,1000.0]"#, "out-of-range");
    reject(r#""velocity_m_s":[0.3,NaN]"#, "not-finite");
    reject(r#""steering_rad":0.1"#, "invalid");
    let stamped = |time_ns: u64| format!(r#"{velocity},"time_ns":{time_ns}"#);
    reject(
        &stamped(singletrackd::monotonic_ns() + 1_000_000_000),
        "future",
    );
    reject(&stamped(u64::MAX), "future");
    reject(&stamped(singletrackd::monotonic_ns() - 300_000_000), "old");
    reject(&stamped(0), "old");
    writeln!(
        client.write,
        r#"{{"version":3,"command":"setpoint",{velocity},"sequence":7}}"#
    )
    .unwrap();
    let mut reject = |keys: &str, word: &str| {
        let line = format!(r#"{{"version":3,"command":"setpoint",{keys}}}"#);
        assert_eq!(client.ask(&line)["code"], word, "{keys}");
    };
    reject(&format!(r#"{velocity},"sequence":7"#), "sequence");
    reject(&format!(r#"{velocity},"sequence":6"#), "sequence");
    assert_eq!(
        status(&mut client)["figures"]["setpoints"],
        json!({
            "accepted": 901,
            "rejected": {
                "invalid": 1, "not-finite": 1, "out-of-range": 1, "future": 2, "old": 2,
                "sequence": 2, "not-external": 3,
            },
            "refused": {},
        })
    );
}

#[test]
fn two_programs_that_steer_at_once_are_not_obeyed_by_turns() {
    let (_daemon, path, _folder) = start();
    let mut one = Client::connect(&path);
    let long = json!({
        "version": 3, "command": "set-reference",
        "reference": { "kind": "external", "setpoint_timeout_ms": 1_000 },
    });
    assert_eq!(one.ask(&long.to_string())["ok"], true);
    let steer = |client: &mut Client, sequence: u32| {
        let line = format!(
            r#"{{"version":3,"command":"setpoint","steering_rad":0,"speed_m_s":0,"sequence":{sequence}}}"#
        );
        writeln!(client.write, "{line}").unwrap();
    };
    let figures = |client: &mut Client| status(client)["figures"]["setpoints"].clone();
    steer(&mut one, 1);
    assert_eq!(figures(&mut one)["accepted"], 1);
    let mut other = Client::connect(&path);
    steer(&mut other, 1);
    let answer = other.line();
    assert_eq!(answer["code"], "other-source", "{answer}");
    let error = answer["error"].as_str().unwrap();
    assert!(error.contains("for 1000 ms"), "{error}");
    steer(&mut one, 2);
    assert_eq!(
        figures(&mut one),
        json!({ "accepted": 2, "rejected": { "other-source": 1 }, "refused": {} })
    );
    // A program that ends gives way long before the time-out. It is the daemon that has to
    // notice: ask until it has.
    drop(one);
    let ended = Instant::now();
    loop {
        steer(&mut other, 1);
        let setpoints = figures_after_answers(&mut other);
        if setpoints["accepted"] == 3 {
            break;
        }
        assert!(ended.elapsed() < Duration::from_millis(900), "{setpoints}");
    }
}

/// The counts of set-points, which follow the answers to those that were rejected.
fn figures_after_answers(client: &mut Client) -> Value {
    writeln!(client.write, r#"{{"version":3,"command":"status"}}"#).unwrap();
    loop {
        let mut answer = client.line();
        if answer["ok"] == true {
            return answer["status"]["figures"]["setpoints"].take();
        }
    }
}

#[test]
fn a_set_point_that_is_accepted_and_then_refused_by_the_pilot_is_counted_by_its_word() {
    let (_daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    assert_eq!(client.ask(&line(EXTERNAL))["ok"], true);
    let mut watcher = Client::connect(&path);
    let watch = r#"{"version":3,"command":"watch","topics":["state"]}"#;
    assert_eq!(watcher.ask(watch)["ok"], true);
    // A hundred points take five ticks to the pilot, and the last one is over by then.
    let brief = || {
        let end_ns = singletrackd::monotonic_ns() + 20_000_000;
        let point = |index| {
            let time_ns = end_ns - (99 - index) * 1_000_000;
            json!({ "time_ns": time_ns, "position_m": [0, 0], "velocity_m_s": [0, 0] })
        };
        let points: Vec<_> = (0..100_u64).map(point).collect();
        json!({ "version": 3, "command": "setpoint", "trajectory": points })
    };
    // On a busy machine it may be over before it is read.
    let begun = Instant::now();
    let rejected = loop {
        writeln!(client.write, "{}", brief()).unwrap();
        let setpoints = figures_after_answers(&mut client);
        if setpoints["accepted"] == 1 {
            break setpoints["rejected"].clone();
        }
        assert!(begun.elapsed() < Duration::from_secs(10), "{setpoints}");
    };
    let refused = loop {
        let state = watcher.line();
        if let Some(word) = state["setpoint_refused"].as_str() {
            break word.to_owned();
        }
    };
    assert_eq!(refused, "old");
    assert_eq!(
        status(&mut client)["figures"]["setpoints"],
        json!({ "accepted": 1, "rejected": rejected, "refused": { "old": 1 } })
    );
}

#[test]
fn the_state_of_every_tick_is_streamed() {
    let (_daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    let watch = r#"{"version":3,"command":"watch","topics":["state"]}"#;
    assert_eq!(client.ask(watch)["ok"], true);
    let first = client.line();
    for count in 1..20 {
        let state = client.line();
        assert_eq!(state["topic"], "state");
        assert_eq!(
            state["tick"].as_u64().unwrap(),
            first["tick"].as_u64().unwrap() + count
        );
        assert!(state["t_s"].as_f64().unwrap() > first["t_s"].as_f64().unwrap());
        assert_eq!(
            (&state["mode"], &state["reason"], &state["x_m"]),
            (&json!("disconnected"), &json!("link-down"), &Value::Null)
        );
    }
}

#[test]
fn a_slow_reader_of_the_state_loses_the_oldest_and_learns_how_many() {
    let (_daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    let watch = r#"{"version":3,"command":"watch","topics":["state"]}"#;
    assert_eq!(client.ask(watch)["ok"], true);
    let mut last = client.line()["tick"].as_u64().unwrap();
    std::thread::sleep(std::time::Duration::from_secs(1));
    let mut missed = 0;
    loop {
        let line = client.line();
        if let Some(count) = line["missed"].as_u64() {
            missed += count;
            continue;
        }
        let tick = line["tick"].as_u64().unwrap();
        assert!(tick > last);
        if missed > 0 {
            assert_eq!(tick, last + missed + 1);
            break;
        }
        assert_eq!(tick, last + 1, "a gap without a word");
        last = tick;
    }
    assert!(missed > 50, "{missed}");
}

#[test]
fn messages_are_those_of_the_record_byte_for_byte_and_of_no_other_topic() {
    let (daemon, path, folder) = start();
    let topics = ["/singletrack/tick", "/diagnostics"];
    let patience = Duration::from_secs(20);
    let mut stream = MessageStream::open(&path, &topics, patience).unwrap();
    let mut received = Vec::new();
    while received.len() < 20 {
        match stream.receive().unwrap() {
            Received::Message(message) => {
                assert!(topics.contains(&message.topic), "{}", message.topic);
                received.push(message.bytes.to_vec());
            }
            Received::Missed(count) => panic!("{count} missed"),
        }
    }
    let unknown = MessageStream::open(&path, &["/odm"], patience).unwrap_err();
    assert!(unknown.to_string().contains("use /singletrack/tick, "));
    daemon.stop().unwrap();
    let record = fs::read_dir(folder.path().join("records"))
        .unwrap()
        .next()
        .unwrap();
    let file = fs::read(record.unwrap().path()).unwrap();
    let recorded: Vec<_> = mcap::MessageStream::new(&file)
        .unwrap()
        .map(|message| message.unwrap().data.into_owned())
        .collect();
    for message in received {
        assert!(recorded.contains(&message), "{message:?}");
    }
}

#[test]
fn a_program_that_sends_without_a_pause_keeps_no_other_client_from_a_stop() {
    const LINES: u64 = 300_000;
    let (_daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    assert_eq!(client.ask(&line(EXTERNAL))["ok"], true);
    let accepted = |client: &mut Client| {
        status(client)["figures"]["setpoints"]["accepted"]
            .as_u64()
            .unwrap()
    };
    let flooder = std::thread::spawn(move || {
        let mut flooder = Client::connect(&path);
        let lines = r#"{"version":3,"command":"setpoint","velocity_m_s":[0.3,0.0]}"#;
        let lines = format!("{lines}\n").repeat(1_000);
        for _ in 0..LINES / 1_000 {
            flooder.write.write_all(lines.as_bytes()).unwrap();
        }
        accepted(&mut flooder)
    });
    // Until the first thousand are there, and then in the middle of them.
    while accepted(&mut client) < 1_000 {}
    assert_eq!(client.ask(r#"{"version":3,"command":"stop"}"#)["ok"], true);
    assert!(accepted(&mut client) < LINES, "it was served after all");
    assert_eq!(flooder.join().unwrap(), LINES);
}

#[test]
fn a_request_to_jog_without_a_board_is_refused_and_pulses_need_a_request() {
    let (_daemon, path, _folder) = start();
    let mut client = Client::connect(&path);
    let arm = r#"{"version":3,"command":"arm","attendance":"hold","jog":true}"#;
    let mut refused = || client.ask(arm)["error"].as_str().unwrap().to_owned();
    // Before the first tick there is no reason.
    let mut error = refused();
    while error == "can't arm: mode disconnected" {
        error = refused();
    }
    // In the words of `singletrack status`.
    assert!(
        error.starts_with("can't arm: mode disconnected: ")
            && error.contains("(link-down). To do: "),
        "{error}"
    );
    let answer = client.ask(r#"{"version":3,"command":"jog","servo_us":1500,"esc_us":1500}"#);
    let error = answer["error"].as_str().unwrap();
    assert!(error.contains("on a connection that jogs"), "{error}");
}

#[test]
fn a_client_reloads_the_file_that_the_daemon_was_started_with() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("control.sock");
    let file = folder.path().join("car.toml");
    let mut config = config(folder.path(), &path);
    let write = |config: &Config| std::fs::write(&file, config.to_toml().unwrap()).unwrap();
    write(&config);
    let options = StartOptions {
        config_path: Some(file.clone()),
        ..StartOptions::default()
    };
    let _daemon = Daemon::start(config.clone(), options).unwrap();
    let mut client = Client::connect(&path);
    let reload = r#"{"version":3,"command":"reload"}"#;
    config.board.servo.centre_us += 7;
    write(&config);
    assert_eq!(
        client.ask(reload),
        json!({"version": 3, "ok": true, "configuration": 2})
    );
    assert_eq!(
        status(&mut client)["configuration"],
        json!({"number": 2, "last_change": {"by": "reload", "error": null}})
    );
    std::fs::write(&file, "[board]").unwrap();
    let answer = client.ask(reload);
    assert_eq!(answer["ok"], false, "{answer}");
    assert_eq!(status(&mut client)["configuration"]["number"], 2);
}

#[test]
fn a_daemon_without_a_file_reloads_nothing() {
    let (_daemon, path, _folder) = start();
    let answer = Client::connect(&path).ask(r#"{"version":3,"command":"reload"}"#);
    let error = answer["error"].as_str().unwrap();
    assert!(error.contains("not started with a file"), "{error}");
}
