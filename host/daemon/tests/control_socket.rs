//! The control socket of a daemon without board and cameras.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    time::Duration,
};

use serde_json::{Value, json};
use singletrack_api::{MessageStream, Received};
use singletrack_core::Config;
use singletrack_pilot::Mode;
use singletrackd::{Daemon, StartOptions};
use tempfile::TempDir;

use crate::{
    common,
    references::{EXTERNAL, line, status},
};

pub(crate) struct Client {
    pub(crate) write: UnixStream,
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

pub(crate) fn start() -> (Daemon, PathBuf, TempDir) {
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

/// The length of what CDR puts before a message, and of the stamp with which its header begins.
const STAMP_END: usize = 4 + 8;

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
                received.push((message.topic == topics[1], message.bytes.to_vec()));
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
    // A client that comes after the first tick is told the state then, with a stamp of its own.
    let mut is_first = true;
    for (is_state, message) in received {
        let from = if is_state && is_first { STAMP_END } else { 0 };
        is_first &= !is_state;
        let is_it = |one: &Vec<u8>| one.get(from..) == message.get(from..);
        assert!(recorded.iter().any(is_it), "{message:?}");
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
