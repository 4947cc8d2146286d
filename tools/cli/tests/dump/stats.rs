//! What is counted.

use std::{
    io::{BufRead, BufReader, Write},
    os::unix::net::UnixListener,
    path::Path,
    thread,
};

use serde_json::{Value, json};
use singletrack_record::{Encoder, Entry};

use crate::{
    fixture::{
        START, START_NS, assert_case, command, driving_tick, dump, entries, recorder, telemetry,
        text,
    },
    pty::OnTerminal,
};

#[test]
fn a_record_is_counted_for_people_and_for_programs() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    for format in ["table", "json"] {
        let output = dump(&path, &["--stats", "--format", format]);
        assert_eq!(text(&output.stderr), "");
        assert!(output.status.success());
        let printed = text(&output.stdout).replace(path.to_str().unwrap(), "drive.mcap");
        assert_case(&format!("stats.{format}"), &printed);
    }
}

/// What `dump` with these arguments writes to a terminal.
fn on_terminal(path: &Path, arguments: &[&str]) -> String {
    let (status, seen, _) = OnTerminal::start(command(path, arguments)).end();
    assert!(status.success(), "{seen}");
    seen.replace("\r\n", "\n")
}

#[test]
fn a_record_alone_is_summarised_on_a_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    let printed = on_terminal(&path, &[]).replace(path.to_str().unwrap(), "drive.mcap");
    assert_case("summary.table", &printed);
    // With an option it is what it asks for, and elsewhere the rows for a program.
    let rows = on_terminal(&path, &["--topic=telemetry"]);
    assert!(rows.trim_start().starts_with("receive_time_ns"), "{rows}");
    let rows = text(&dump(&path, &[]).stdout);
    assert!(rows.starts_with("receive_time_ns,"), "{rows}");
}

#[test]
fn losses_gaps_and_latencies_are_those_of_the_record() {
    let folder = tempfile::tempdir().unwrap();
    let (mut recorder, path) = recorder(folder.path());
    // The fixture ends with telemetry 1; then 4 of 2 to 9 are lost, in two gaps.
    for index in [2, 4, 5, 9] {
        recorder.write(&telemetry(index)).unwrap();
    }
    for index in 2..102_u64 {
        let mut tick = driving_tick();
        tick.index = index;
        tick.scheduled_ns = START_NS + index * 10_000_000;
        tick.start_ns = tick.scheduled_ns + index * 1_000;
        tick.skipped = u32::from(index == 50);
        tick.events_dropped = u32::from(index > 98);
        tick.output.held = index > 90;
        recorder.write(&Entry::Tick(tick)).unwrap();
    }
    recorder.flush().unwrap();
    let output = dump(&path, &["--stats", "--format=json"]);
    assert!(text(&output.stderr).contains("unfinished"));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["unfinished"], true);
    let topic = |name: &str| {
        let topics = report["topics"].as_array().unwrap();
        topics.iter().find(|one| one["topic"] == name).unwrap()
    };
    assert_eq!(topic("telemetry")["count"], 6);
    assert_eq!(topic("tick")["count"], 102);
    let rate = topic("tick")["rate_hz"].as_f64().unwrap();
    assert!((rate - 100.0).abs() < 0.1, "{rate}");
    let line = &report["line"];
    assert_eq!(line["telemetry_lost"], 4);
    assert_eq!(line["gaps"], 2);
    assert_eq!(line["longest_gap_ms"], 40.0);
    assert_eq!(line["longest_gap_at_s"], 0.0541);
    assert_eq!(line["board_restarts"], 0);
    let ticks = &report["ticks"];
    assert_eq!(ticks["skipped"], 1);
    assert_eq!(ticks["events_dropped"], 3);
    // The standing tick is the twelfth.
    assert_eq!(ticks["without_new_pose"], 12);
    let lateness = &report["lateness_us"];
    assert_eq!(lateness["count"], 102);
    assert_eq!(lateness["min"], 2.0);
    assert_eq!(lateness["max"], 101.0);
    // Of ticks with a new pose only.
    assert_eq!(report["capture_to_command_us"]["count"], 90);
    let modes = report["modes"].as_array().unwrap();
    assert_eq!(modes.len(), 2);
    assert_eq!(modes[0]["mode"], "idle");
    assert_eq!(modes[0]["reason"], "no-pose");
    assert_eq!(modes[1]["mode"], "driving");
}

#[test]
fn only_what_is_chosen_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, path) = recorder(folder.path());
    recorder.finish().unwrap();
    let arguments = ["--stats", "--format=json", "--topic=tick", "--where=tick=1"];
    let report: Value = serde_json::from_slice(&dump(&path, &arguments).stdout).unwrap();
    let topics = report["topics"].as_array().unwrap();
    assert_eq!(topics.len(), 1);
    assert_eq!(topics[0]["count"], 1);
    assert_eq!(report["lateness_us"]["max"], 61.0);
    assert_eq!(report["board"], Value::Null);
}

#[test]
fn what_the_daemon_tells_is_counted_until_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("daemon.sock");
    let listener = UnixListener::bind(&socket).unwrap();
    let daemon = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut request = String::new();
        BufReader::new(&stream).read_line(&mut request).unwrap();
        let clocks = json!({ "monotonic_ns": START.monotonic_ns, "wall_ns": START.wall_ns });
        let answer = json!({ "version": 1, "ok": true, "clocks": clocks });
        writeln!(stream, "{answer}").unwrap();
        writeln!(stream, "{{\"version\":1,\"missed\":7}}").unwrap();
        let mut encoder = Encoder::new(START);
        for entry in entries() {
            for message in encoder.encode(&entry).unwrap() {
                let head =
                    json!({ "topic": message.channel.topic(), "bytes": message.bytes.len() });
                writeln!(stream, "{head}").unwrap();
                stream.write_all(message.bytes).unwrap();
            }
        }
    });
    let socket = socket.to_str().unwrap();
    let arguments = ["--stats", "--format=json", "--socket", socket];
    let output = dump(Path::new("live"), &arguments);
    daemon.join().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["missed"], 7);
    assert_eq!(report["entries_dropped"], 3);
    assert_eq!(report["lateness_us"]["count"], 2);
    assert_eq!(report["modes"][1]["duration_s"], 0.004_039);
}
