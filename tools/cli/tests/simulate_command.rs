//! `singletrack simulate` as a person or a script sees it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

use tempfile::TempDir;

fn scenario(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../scenarios")
        .join(name)
}

fn simulate(scenario: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("simulate")
        .arg(scenario)
        .args(["--format", "csv"])
        .output()
        .unwrap()
}

#[test]
fn standard_output_holds_only_csv_with_a_row_every_50_ms() {
    let output = simulate(&scenario("steps.toml"));
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    let mut lines = text.lines();
    assert_eq!(
        lines.next(),
        Some(
            "t,yaw,yaw_rate,sideslip,steering,x_g,y_g,speed,steering_rate,x_p,y_p,x_ref,y_ref,v_px,v_py,path_s"
        )
    );
    let rows: Vec<Vec<f64>> = lines
        .map(|line| {
            line.split(',')
                .map(|field| field.parse().unwrap())
                .collect()
        })
        .collect();
    assert_eq!(rows.len(), 361);
    for (index, row) in rows.iter().enumerate() {
        assert_eq!(row.len(), 16);
        assert!((row[0] - index as f64 * 0.05).abs() < 1e-9);
    }
}

#[test]
fn a_circle_that_the_car_can_not_drive_is_a_failure_with_the_least_radius() {
    let text = std::fs::read_to_string(scenario("circle-car.toml")).unwrap();
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("small.toml");
    let text = text.replace("radius_m = 1.0", "radius_m = 0.3");
    std::fs::write(&path, text.replace("duration_s = 40.0", "duration_s = 1.0")).unwrap();
    let output = simulate(&path);
    let error = String::from_utf8(output.stderr).unwrap();
    let finding = "impossible: reference.radius_m is 0.3: ";
    assert!(
        error.contains(finding) && error.contains("give at least 0.78"),
        "{error}"
    );
    assert!(output.status.code() == Some(1) && !output.stdout.is_empty());
    // A program judges by the summary.
    let mut command = Command::new(env!("CARGO_BIN_EXE_singletrack"));
    command.arg("simulate").arg(&path);
    let summary = command.args(["--summary", "json"]).output().unwrap();
    assert!(summary.status.success());
    let good = simulate(&scenario("circle-car.toml"));
    assert!(good.status.success() && good.stderr.is_empty());
}

/// Changes a scenario, and expects an error that says all of `words`.
fn assert_refused(from: &str, to: &str, words: &[&str]) {
    let (_folder, path) = changed("circle-sampled.toml", &[(from, to)]);
    let output = simulate(&path);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success(), "{to:?} was taken");
    assert!(output.stdout.is_empty());
    for word in words {
        assert!(error.contains(word), "{word:?} is not in {error:?}");
    }
}

#[test]
fn unknown_keys_are_refused_by_name() {
    for (from, to) in [
        ("[law]", "[law]\ncolour = 1"),
        ("[outer_loop]", "[outer_loop]\ncolour = 1"),
        ("[reference]", "[reference]\ncolour = 1"),
        ("[start]", "[start]\ncolour = 1"),
        ("[control]", "[control]\ncolour = 1"),
        ("[plant]", "[plant]\ncolour = 1"),
        ("[run]", "[run]\ncolour = 1"),
        ("[[marker_loss]]", "[[marker_loss]]\ncolour = 1"),
        ("[law]", "[colour]\n[law]"),
    ] {
        assert_refused(from, to, &["colour"]);
    }
}

#[test]
fn an_invalid_value_is_refused_with_its_key() {
    for (from, to, words) in [
        (
            "point_distance_m = 0.35",
            "point_distance_m = 0.0",
            ["point_distance_m", "0"],
        ),
        (
            "front_axle_distance_m = 0.1368",
            "front_axle_distance_m = 0.3",
            ["front_axle_distance_m", "0.3"],
        ),
        ("radius_m = 1.0", "radius_m = -1.0", ["radius_m", "-1"]),
        (
            "period_ms = 10",
            "period_ms = 0",
            ["period_ms", "delay_ticks"],
        ),
        (
            "first_tick = 130",
            "first_tick = 9000000000",
            ["first_tick", "9000000000"],
        ),
        (
            "gain_per_s = [1.0, 1.0]",
            "gain_per_s = [1.0, -1.0]",
            ["gain_per_s", "-1"],
        ),
        (
            "duration_s = 18.0",
            "duration_s = inf",
            ["duration_s", "inf"],
        ),
        (
            "kind = \"ideal\"",
            "kind = \"perfect\"",
            ["perfect", "ideal"],
        ),
    ] {
        assert_refused(from, to, &words);
    }
}

#[test]
fn a_loss_in_continuous_control_is_refused() {
    assert_refused(
        "period_ms = 10\ndelay_ticks = 1",
        "period_ms = 0\ndelay_ticks = 0",
        &["marker_loss", "continuous"],
    );
}

#[test]
fn a_file_that_is_not_there_is_named() {
    let output = simulate(Path::new("no-such-scenario.toml"));
    assert!(!output.status.success());
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("no-such-scenario.toml")
    );
}

/// A changed scenario, in a folder of its own.
fn changed(name: &str, changes: &[(&str, &str)]) -> (TempDir, PathBuf) {
    let mut text = std::fs::read_to_string(scenario(name)).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "{from:?} is not in the scenario");
        text = text.replacen(from, to, 1);
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scenario.toml");
    std::fs::write(&path, text).unwrap();
    (folder, path)
}

/// Runs a scenario that was changed; returns what was said.
fn run_changed(name: &str, changes: &[(&str, &str)]) -> Output {
    let (_folder, path) = changed(name, changes);
    simulate(&path)
}

#[test]
fn a_car_that_stops_early_says_when_and_why_beside_its_rows() {
    let output = run_changed(
        "circle-car.toml",
        &[(
            "duration_s = 40.0",
            "duration_s = 4.0\n[[marker_loss]]\nfirst_tick = 100\nticks = 200",
        )],
    );
    assert!(output.status.success());
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("pose-too-old"), "{said}");
    assert_eq!(output.stdout.split(|byte| *byte == b'\n').count(), 83);
}

#[test]
fn what_the_car_does_not_take_from_a_scenario_is_said() {
    let output = run_changed(
        "circle-car.toml",
        &[
            ("period_ms = 10", "period_ms = 10\ndelay_ticks = 1"),
            ("duration_s = 40.0", "duration_s = 0.5"),
        ],
    );
    assert!(output.status.success());
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("delay_ticks")
    );
}

#[test]
fn a_loss_of_frames_that_are_under_way_is_refused_on_the_car() {
    let output = run_changed(
        "circle-car.toml",
        &[(
            "duration_s = 40.0",
            "duration_s = 0.5\n[[marker_loss]]\nfirst_tick = 1\nticks = 1",
        )],
    );
    assert!(!output.status.success());
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("first_tick")
    );
}

/// Runs a changed scenario with a summary.
fn summarise(name: &str, changes: &[(&str, &str)]) -> Output {
    let (_folder, path) = changed(name, changes);
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("simulate")
        .arg(&path)
        .args(["--summary", "json"])
        .output()
        .unwrap()
}

#[test]
fn a_summary_is_one_object_with_these_keys() {
    let output = summarise(
        "circle-car.toml",
        &[("duration_s = 40.0", "duration_s = 1.0")],
    );
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text.lines().count(), 1);
    let object: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&text).unwrap();
    let mut keys: Vec<_> = object.keys().map(String::as_str).collect();
    keys.sort_unstable();
    assert_eq!(
        keys,
        [
            "armed",
            "calibration",
            "clearance_min_m",
            "ended_s",
            "mode",
            "reason",
            "speed_end_m_s",
            "speed_max_m_s",
            "speed_min_m_s",
            "tracking_error",
            "tracking_rms_m",
            "way_after_m",
            "way_m"
        ]
    );
    assert_eq!(object["armed"], true);
    assert_eq!(object["mode"], "driving");
    assert!(object["reason"].is_null() && object["ended_s"].is_null());
    for key in ["rms_m", "max_m", "end_m"] {
        let error = object["tracking_error"][key].as_f64().unwrap();
        assert!((0.1..1.0).contains(&error), "{key}: {error}");
    }
}

#[test]
fn a_summary_of_a_car_with_an_operator_says_why_it_ended() {
    let end = "duration_s = 3.0\n[operator]\nemergency_stop_at_s = 2.0";
    let output = summarise("circle-car.toml", &[("duration_s = 40.0", end)]);
    let object: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(object["reason"], "emergency-stop");
    assert_eq!(object["speed_end_m_s"], 0.0);
    // The note of the trajectory stays on the other stream.
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("emergency-stop")
    );
}

/// What is printed without `--format`.
fn printed(name: &str, changes: &[(&str, &str)]) -> String {
    let (_folder, path) = changed(name, changes);
    let mut command = Command::new(env!("CARGO_BIN_EXE_singletrack"));
    let output = command.arg("simulate").arg(&path).output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn without_options_the_result_is_printed_and_no_trajectory() {
    // Theory expects 447.2 mm.
    let text = printed("circle.toml", &[]);
    assert_eq!(text.lines().count(), 1, "{text}");
    assert!(
        text.starts_with("distance of P from its reference: ")
            && text.ends_with("447.2 mm at the end\n"),
        "{text}"
    );
    let short = ("duration_s = 40.0", "duration_s = 1.0");
    let text = printed("circle-car.toml", &[short]);
    let lines: Vec<_> = text.lines().collect();
    assert_eq!(lines[0], "the car drove to the end of the run", "{text}");
    assert!(lines[1].starts_with("distance of P from its reference: "));
    assert!(lines[1].ends_with(" mm (rms) in the second half"));
    assert!(lines[2].starts_with("travelled 0."), "{text}");
    let stopped = "duration_s = 3.0\n[operator]\nemergency_stop_at_s = 2.0";
    let text = printed("circle-car.toml", &[(short.0, stopped)]);
    assert!(
        text.starts_with("the drive ended at 2.0") && text.contains(": emergency-stop; "),
        "{text}"
    );
    let unarmed = "duration_s = 1.0\n[operator]\narm = false";
    let text = printed("circle-car.toml", &[(short.0, unarmed)]);
    assert!(text.starts_with("the car was not armed: "), "{text}");
}

#[test]
fn a_mistake_in_a_scenario_is_said_with_line_and_key_in_plain_words() {
    for (from, to, said) in [
        (
            "duration_s = 18.0",
            "duration_s = \"x\"",
            "run.duration_s = \"x\": it must be a number",
        ),
        (
            "duration_s = 18.0",
            "duration_s = 18,5",
            "run.duration_s = 18,5: write a number with a point: 18.5",
        ),
    ] {
        assert_refused(from, to, &[said]);
    }
    let limits = ("[law]", "[limits]\nmax_speed_m_s = \"x\"\n[law]");
    let output = run_changed("circle-car.toml", &[limits]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(
        error.contains("[limits] max_speed_m_s: it must be a number"),
        "{error}"
    );
}

#[test]
fn the_ideal_plant_has_no_summary() {
    let output = summarise("circle.toml", &[]);
    assert!(!output.status.success() && output.stdout.is_empty());
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("plant.kind")
    );
}
