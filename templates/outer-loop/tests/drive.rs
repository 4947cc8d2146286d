//! The loop in the programs: simulated, recorded, replayed, compared, checked and refused.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

const SCENARIO: &str = include_str!("../circle.toml");
const OWN: &str = "kind = \"own\"\nname = \"my-loop\"\nown = { look_ahead_s = 0.15 }";

fn run(folder: &Path, line: &str) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_my-loop"));
    program.args(line.split(' ')).current_dir(folder);
    program.output().unwrap()
}

fn prints(folder: &Path, line: &str) -> String {
    let output = run(folder, line);
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{line}: {told}");
    String::from_utf8(output.stdout).unwrap()
}

fn refuses(folder: &Path, line: &str) -> String {
    let output = run(folder, line);
    assert!(!output.status.success(), "{line}");
    String::from_utf8(output.stderr).unwrap()
}

/// The configuration of the demo, with these keys in `[outer_loop]`.
fn configuration(folder: &Path, keys: &str) {
    let demo = folder.join("demo");
    if !demo.exists() {
        prints(folder, "demo --virtual --for 1s --out demo");
    }
    let text = fs::read_to_string(demo.join("demo.toml")).unwrap();
    let start = text.find("[outer_loop]\n").unwrap();
    let end = start + text[start..].find("\n[").unwrap();
    let (before, after) = (&text[..start], &text[end..]);
    let text = format!("{before}[outer_loop]\n{keys}\n{after}");
    fs::write(folder.join("car.toml"), text).unwrap();
}

#[test]
fn a_drive_is_recorded_and_replayed_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("circle.toml"), SCENARIO).unwrap();
    let told = prints(folder, "simulate circle.toml --record circle.mcap");
    assert!(
        told.contains("the car drove to the end of the run"),
        "{told}"
    );
    let told = prints(folder, "replay circle.mcap");
    assert!(told.contains("every output the same to the bit"), "{told}");
    let told = prints(
        folder,
        "replay circle.mcap --set outer_loop.own.look_ahead_s=0.4",
    );
    assert!(told.contains("recorded and replayed commands"), "{told}");
}

#[test]
fn the_safety_filter_keeps_the_car_inside_whatever_the_loop_wants() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // A circle through the eastern wall, from its western end.
    let mut text = SCENARIO.replace("start = \"beginning\"\n", "");
    text = text
        .replace("[1.5, -0.5]", "[-1.0, 0.0]")
        .replace("135.0", "-90.0");
    text += "[fence]\ncorners_m = [[-1.9, -1.9], [0.9, -1.9], [0.9, 1.9], [-1.9, 1.9]]\n\
             braking_m_s2 = 0.9\n[safety_filter]\nenabled = true\n";
    fs::write(folder.join("wall.toml"), text).unwrap();
    let line = "simulate wall.toml --record wall.mcap --summary json";
    let summary = prints(folder, line);
    let clearance = summary.split("\"clearance_min_m\":").nth(1).unwrap();
    let clearance: f64 = clearance.split(',').next().unwrap().parse().unwrap();
    assert!(clearance > 0.2, "{summary}");
    let dump = "dump wall.mcap --topic tick --format csv --fields filtering";
    let limited = prints(folder, dump).matches("limited").count();
    assert!(limited > 100, "{limited} ticks");
}

#[test]
fn it_has_a_row_beside_the_other_controllers() {
    let folder = tempfile::tempdir().unwrap();
    let line = "compare --controllers my-loop,p-compensated --paths ellipse --speeds 1.0 --count 1";
    let told = prints(folder.path(), line);
    assert!(told.contains("| my-loop |"), "{told}");
    assert!(told.contains("| p-compensated |"), "{told}");
}

#[test]
fn the_daemon_takes_it_and_refuses_what_it_does_not_have() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let check = "singletrackd --config car.toml --check";
    configuration(folder, OWN);
    assert!(prints(folder, check).contains("car.toml: good"));
    for (from, to, message) in [
        (
            "my-loop",
            "your-loop",
            "outer_loop.name is your-loop: this program has only my-loop",
        ),
        (
            "look_ahead_s",
            "look_ahead",
            "outer_loop.own.look_ahead: unknown key",
        ),
        (
            "0.15",
            "5.0",
            "outer_loop.own.look_ahead_s is 5: it must be",
        ),
        (
            "0.15",
            "0.001",
            "outer_loop.own.look_ahead_s is 0.001: it must be at least two ticks",
        ),
        (
            "own =",
            "version = \"0.0.1\"\nown =",
            "outer_loop.version is 0.0.1: this program has",
        ),
    ] {
        configuration(folder, &OWN.replace(from, to));
        let told = refuses(folder, check);
        assert!(told.contains(message), "{told}");
    }
}
