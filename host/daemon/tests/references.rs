//! References and set-points over the control socket of a daemon without board and cameras.

use std::{
    io::Write,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use singletrack_core::{Config, config::ReferenceSection};

use crate::control_socket::{Client, start};

const CIRCLE: &str = r#"{"version":3,"command":"set-reference","reference":
    {"kind":"circle","radius_m":0.8,"angular_velocity_rad_s":0.4}}"#;
pub(crate) const EXTERNAL: &str = r#"{"version":3,"command":"set-reference","reference":
    {"kind":"external"}}"#;

/// The text on one line.
pub(crate) fn line(text: &str) -> String {
    text.replace('\n', " ")
}

pub(crate) fn status(client: &mut Client) -> Value {
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
