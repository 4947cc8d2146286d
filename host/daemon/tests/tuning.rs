//! Requests to tune, to a daemon without board and cameras.

#![allow(
    clippy::unwrap_used,
    reason = "the helpers of tests may fail as tests do"
)]

use std::path::Path;

use serde_json::{Value, json};
use singletrack_core::config::TuningSection;
use singletrack_pilot::Event;
use singletrack_record::{Entry, Reader, Replay};
use singletrackd::{Daemon, StartOptions};

use crate::control_socket::{Client, config};

fn ask(client: &mut Client, keys: &Value) -> Value {
    let mut line = json!({ "version": 3, "command": "tune" });
    let keys = keys.as_object().unwrap().clone();
    line.as_object_mut().unwrap().extend(keys);
    client.ask(&line.to_string())
}

fn whole_status(client: &mut Client) -> Value {
    client.ask(r#"{"version":3,"command":"status"}"#)["status"].take()
}

fn status(client: &mut Client) -> Value {
    whole_status(client)["tuning"].take()
}

fn start(folder: &Path, tuning: TuningSection) -> (Daemon, Client) {
    let socket = folder.join("control.sock");
    let mut config = config(folder, &socket);
    config.tuning = tuning;
    let daemon = Daemon::start(config, StartOptions::default()).unwrap();
    let mut client = Client::connect(&socket);
    while whole_status(&mut client)["state"].is_null() {}
    (daemon, client)
}

const BOTH: TuningSection = TuningSection {
    enabled: true,
    gain_per_s: Some([0.8, 4.0]),
    point_distance_m: Some([0.3, 0.36]),
};

#[test]
fn values_within_their_bounds_are_in_force_when_they_are_answered_and_are_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let (daemon, mut client) = start(folder.path(), BOTH);
    let before = status(&mut client);
    assert_eq!(before["differs"], false, "{before}");
    assert_eq!(before["bounds"]["gain_per_s"], json!([0.8, 4.0]));

    let answer = ask(
        &mut client,
        &json!({ "gain_per_s": 2.0, "point_distance_m": 0.36 }),
    );
    assert_eq!(answer["ok"], true, "{answer}");
    assert_eq!(answer["tuning"]["gain_per_s"], json!([2.0, 2.0]));
    assert_eq!(answer["tuning"]["wanted_point_distance_m"], 0.36);
    let on_its_way = answer["tuning"]["point_distance_m"].as_f64().unwrap();
    assert!((0.35..0.36).contains(&on_its_way), "{answer}");
    let after = status(&mut client);
    assert_eq!(after["differs"], true, "{after}");
    assert_eq!(after["configured"]["gain_per_s"], json!([1.0, 1.0]));

    let answer = ask(&mut client, &json!({ "gain_per_s": [1.0, 1.5] }));
    assert_eq!(
        answer["tuning"]["gain_per_s"],
        json!([1.0, 1.5]),
        "{answer}"
    );
    client.ask(r#"{"version":3,"command":"watch","topics":["state"]}"#);
    let state = client.line();
    assert_eq!(state["gain_per_s"], json!([1.0, 1.5]), "{state}");
    assert!(state["point_distance_m"].is_number(), "{state}");
    daemon.stop().unwrap();

    let records = std::fs::read_dir(folder.path().join("records")).unwrap();
    let record = records.flatten().next().unwrap().path();
    let mut pilot = config(folder.path(), Path::new("socket"));
    pilot.tuning = BOTH;
    let mut replay = Replay::new(pilot.pilot().unwrap());
    let mut tunings = 0;
    for entry in Reader::open(&record).unwrap() {
        if let Entry::Tick(tick) = entry.unwrap() {
            tunings += tick
                .events
                .iter()
                .filter(|event| matches!(event, Event::Tuning(_)))
                .count();
            let replayed = replay.tick(&tick).unwrap();
            assert_eq!(tick.differences(&replayed), []);
        }
    }
    assert_eq!(tunings, 2);
}

#[test]
fn what_is_refused_is_refused_with_the_reason_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (daemon, mut client) = start(folder.path(), BOTH);
    for (keys, parts) in [
        (
            json!({ "gain_per_s": 4.5 }),
            ["gain_per_s is 4.5", "between 0.8 and 4"],
        ),
        (
            json!({ "gain_per_s": [1.0, 0.5] }),
            ["gain_per_s is 0.5", "between 0.8 and 4"],
        ),
        (
            json!({ "gain_per_s": 2.0, "point_distance_m": 0.37 }),
            ["point_distance_m is 0.37", "between 0.3 and 0.36"],
        ),
        (
            json!({ "gain_per_s": 1.0 }),
            ["nothing changes", "in force"],
        ),
        (json!({}), ["nothing to tune", "gain_per_s"]),
        (
            json!({ "gain_per_s": null }),
            ["nothing to tune", "gain_per_s"],
        ),
        (
            json!({ "gain_per_s": "fast" }),
            ["gain_per_s is \"fast\"", "give a number"],
        ),
        (
            json!({ "gain_per_s": [1.0] }),
            ["gain_per_s is [1.0]", "two for x and y"],
        ),
        (
            json!({ "weight": 1.0 }),
            ["tune: unknown key weight", "gain_per_s"],
        ),
        (
            json!({ "for_s": 1.0, "gain_per_s": 2.0 }),
            ["tune: unknown key for_s", "point_distance_m"],
        ),
    ] {
        let answer = ask(&mut client, &keys);
        assert_eq!(answer["ok"], false, "{keys}: {answer}");
        let error = answer["error"].as_str().unwrap();
        for part in parts {
            assert!(error.contains(part), "{keys}: {error}");
        }
    }
    // JSON has no such number.
    let answer = client.ask(r#"{"version":3,"command":"tune","gain_per_s":NaN}"#);
    assert_eq!(answer["ok"], false, "{answer}");
    assert_eq!(status(&mut client)["differs"], false);
    daemon.stop().unwrap();
}

#[test]
fn nothing_can_be_tuned_unless_it_is_enabled() {
    let folder = tempfile::tempdir().unwrap();
    let (daemon, mut client) = start(folder.path(), TuningSection::default());
    let answer = ask(&mut client, &json!({ "gain_per_s": 2.0 }));
    let error = answer["error"].as_str().unwrap();
    assert!(error.contains("tuning.enabled = true"), "{error}");
    assert_eq!(status(&mut client), Value::Null);
    daemon.stop().unwrap();
}

#[test]
fn a_reference_keeps_tuned_values_and_another_value_in_the_file_ends_them() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("control.sock");
    let file = folder.path().join("singletrackd.toml");
    let mut config = config(folder.path(), &socket);
    config.tuning = BOTH;
    std::fs::write(&file, config.to_toml().unwrap()).unwrap();
    let options = StartOptions {
        config_path: Some(file.clone()),
        ..StartOptions::default()
    };
    let daemon = Daemon::start(config.clone(), options).unwrap();
    let mut client = Client::connect(&socket);
    while whole_status(&mut client)["state"].is_null() {}
    assert_eq!(ask(&mut client, &json!({ "gain_per_s": 2.0 }))["ok"], true);

    let external = r#"{"version":3,"command":"set-reference","reference":{"kind":"external"}}"#;
    assert_eq!(client.ask(external)["ok"], true);
    let status = whole_status(&mut client);
    assert_eq!(status["state"]["gain_per_s"], json!([2.0, 2.0]));

    let text = config.to_toml().unwrap();
    let text = text.replace("gain_per_s = [1.0, 1.0]", "gain_per_s = [1.5, 1.5]");
    std::fs::write(&file, text).unwrap();
    let answer = client.ask(r#"{"version":3,"command":"reload"}"#);
    assert_eq!(answer["ok"], true, "{answer}");
    let mut status = whole_status(&mut client);
    while status["state"]["gain_per_s"] == json!([2.0, 2.0]) {
        status = whole_status(&mut client);
    }
    let gain = &status["state"]["gain_per_s"];
    assert_eq!(*gain, json!([1.5, 1.5]), "{status}");
    assert_eq!(status["tuning"]["differs"], false, "{status}");
    daemon.stop().unwrap();
}
