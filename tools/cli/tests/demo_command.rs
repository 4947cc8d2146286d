//! `singletrack demo` as a person or a script sees it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    path::Path,
    process::{Command, Output, Stdio},
    sync::{Mutex, PoisonError},
    thread,
    time::Duration,
};

use singletrack_control::{SlipAngles, VehicleParameters};
use singletrack_core::Config;
use singletrack_record::{Ending, Reader};
use singletrack_sim::SimulationConfig;

/// A demo needs the machine's real time for itself.
static REAL_TIME: Mutex<()> = Mutex::new(());

fn demo(out: &Path, options: &[&str]) -> Output {
    let _alone = REAL_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(["demo", "--out"])
        .arg(out)
        .args(options)
        .output()
        .unwrap()
}

#[test]
fn a_demo_in_a_pipe_prints_its_summary_and_leaves_what_it_promises() {
    let folder = tempfile::tempdir().unwrap();
    let output = demo(
        folder.path(),
        &["--for", "2s", "--live", "0", "--watch", "0"],
    );
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let open = format!("Open {}\n", folder.path().join("report.html").display());
    assert!(printed.ends_with(&open), "{printed}");
    for line in [
        "Drove 2.0 s of the paper's circle.\n",
        "  theory, settled     amplitude 0.894 m, lag 0.464 rad, RMS error 447.2 mm",
        "  cameras  ",
    ] {
        assert!(printed.contains(line), "{line}\n{printed}");
    }
    // The addresses of the page and of the live view, and no progress in a pipe.
    let port = |line: Option<&str>, before: &str| {
        let rest = line?.strip_prefix(before)?;
        rest.split(' ').next()?.parse::<u16>().ok()
    };
    let mut lines = said.lines();
    let page = port(
        lines.next(),
        "Watch the drive in a browser: http://127.0.0.1:",
    );
    let live = port(lines.next(), "Live view: ws://127.0.0.1:");
    assert!(
        page.is_some_and(|port| port > 0) && live.is_some_and(|port| port > 0),
        "{said}"
    );
    assert_eq!(lines.next(), None);

    let mut names: Vec<_> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert_eq!(
        names,
        [
            "animation.svg",
            "demo.mcap",
            "demo.toml",
            "figures",
            "report.html",
            "simulation.toml",
            "summary.json"
        ],
        "exactly one record among them, and a finished one"
    );
    let mut record = Reader::open(&folder.path().join("demo.mcap")).unwrap();
    assert!(record.by_ref().all(|entry| entry.is_ok()));
    assert_eq!(record.ending, Some(Ending::Finished));
    let replay = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(["replay", "--verify"])
        .arg(folder.path().join("demo.mcap"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&replay.stderr).into_owned();
    assert!(replay.status.success(), "{said}");
    let trajectory = folder.path().join("figures/trajectory.svg");
    let trajectory = std::fs::read_to_string(trajectory).unwrap();
    for curve in ["nominal", "actual", "truth"] {
        assert!(
            trajectory.contains(&format!("<path class=\"{curve}\"")),
            "{curve}"
        );
    }
    let report = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(
        report.contains("true tracking error"),
        "the simulation knows"
    );
    let summary = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    for (pointer, at_least) in [
        ("/ticks", 300.0),
        ("/deadline_misses", 0.0),
        ("/lateness_us/p50", 0.0),
        ("/lateness_us/p99", 0.0),
        ("/lateness_us/max", 0.0),
        ("/frames/sent", 150.0),
        ("/frames/received", 300.0),
        ("/frames/crc_errors", 0.0),
        ("/mocap/frames", 300.0),
        ("/mocap/lost", 0.0),
        ("/mocap/held_ticks", 0.0),
        ("/capture_to_command_us/p50", 8_000.0),
        ("/capture_to_command_us/p99", 8_000.0),
    ] {
        let value = summary.pointer(pointer).and_then(serde_json::Value::as_f64);
        assert!(
            value.is_some_and(|value| value >= at_least),
            "{pointer}: {value:?}"
        );
    }
    assert!(
        summary["tracking"].is_null(),
        "two seconds are no full turn"
    );
    let error_mm = 1e3 * summary["rms_error_m"].as_f64().unwrap();
    let line = format!("P, from the start   RMS error {error_mm:.1} mm");
    assert!(printed.contains(&line), "{line}\n{printed}");
}

#[test]
fn in_virtual_time_the_same_is_reported_and_twice_the_same() {
    let run = || {
        let folder = tempfile::tempdir().unwrap();
        let output = demo(folder.path(), &["--virtual", "--for", "20s"]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{said}");
        let printed = String::from_utf8_lossy(&output.stdout).into_owned();
        for line in [
            "Drove 20.0 s of the paper's circle, in virtual time.\n",
            "  P, last full turn   amplitude 0.89",
            "Open ",
        ] {
            assert!(printed.contains(line), "{line}\n{printed}");
        }
        for name in ["animation.svg", "report.html", "demo.toml"] {
            assert!(folder.path().join(name).exists(), "{name}");
        }
        ["summary.json", "demo.mcap"].map(|name| std::fs::read(folder.path().join(name)).unwrap())
    };
    let [summary, record] = run();
    let summary_value: serde_json::Value = serde_json::from_slice(&summary).unwrap();
    let error_m = summary_value["tracking"]["rms_error_m"].as_f64().unwrap();
    assert!((error_m - 0.447).abs() < 0.02, "{error_m} m");
    assert_eq!(run()[0], summary);
    assert!(!record.is_empty());
}

#[test]
fn a_demo_that_the_computer_holds_up_goes_on_in_virtual_time_and_says_so() {
    let _alone = REAL_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let mut demo = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(["demo", "--for", "30s", "--out"])
        .arg(folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let signal = |demo: &std::process::Child, name: &str| {
        let id = demo.id().to_string();
        let sent = Command::new("kill").args([name, &id]).status().unwrap();
        assert!(sent.success());
    };
    // Held up again and again, also while it drives.
    while demo.try_wait().unwrap().is_none() {
        thread::sleep(Duration::from_secs(2));
        if demo.try_wait().unwrap().is_none() {
            signal(&demo, "-STOP");
            thread::sleep(Duration::from_millis(500));
            signal(&demo, "-CONT");
        }
    }
    let output = demo.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(said.contains("too busy for real time"), "{said}");
    assert!(
        printed.starts_with("Drove 30.0 s of the paper's circle, in virtual time."),
        "{printed}"
    );
}

#[test]
fn a_folder_of_something_else_or_of_another_demo_is_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let thesis = folder.path().join("thesis.tex");
    std::fs::write(&thesis, "text").unwrap();
    let refused = |word: &str| {
        let output = demo(folder.path(), &["--virtual", "--for", "1s"]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{said}");
        assert!(said.contains(word) && said.contains("--out"), "{said}");
    };
    refused("thesis.tex");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    std::fs::remove_file(&thesis).unwrap();
    let other = std::fs::File::open(folder.path()).unwrap();
    other.lock().unwrap();
    refused("another demo");
    drop(other);
    for _ in 0..2 {
        let output = demo(folder.path(), &["--virtual", "--for", "1s"]);
        assert!(output.status.success(), "its own files are replaced");
    }
}

#[test]
fn a_drive_that_ends_early_is_a_failure_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let output = demo(folder.path(), &["--for", "4s", "--loss", "900ms@1s"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success());
    assert!(said.contains("pose-too-old"), "{said}");
    for file in [
        "summary.json",
        "report.html",
        "animation.svg",
        "figures/trajectory.svg",
    ] {
        assert!(folder.path().join(file).exists(), "{file}: it is reported");
    }
}

#[test]
fn options_that_make_no_sense_are_refused_with_the_fix() {
    let folder = tempfile::tempdir().unwrap();
    for (options, word) in [
        (["--loss", "2s"], "200ms@2s"),
        (["--loss", "3s@2s"], "shorter"),
        (["--for", "soon"], "duration"),
        (["--car", "truck"], "dart"),
    ] {
        let output = demo(folder.path(), &options);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(word), "{said}");
    }
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn the_cars_that_are_made_of_real_ones_logs_drive_too() {
        for (car, mass_kg, vibration) in [("dart", 1.58, 0.79), ("put", 5.1, 0.4)] {
            let folder = tempfile::tempdir().unwrap();
            let output = demo(folder.path(), &["--virtual", "--for", "2s", "--car", car]);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(output.status.success(), "{said}");
            let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
            let believed = Config::from_toml(&read("demo.toml")).unwrap();
            let truth: SimulationConfig = toml::from_str(&read("simulation.toml")).unwrap();
            assert_eq!(believed.vehicle.mass_kg, mass_kg);
            assert_eq!(truth.car.vehicle.mass_kg, mass_kg);
            // What is believed is not what is true.
            let stiffness = |vehicle: &VehicleParameters| vehicle.rear_cornering_stiffness_n_rad;
            assert!(
                stiffness(&believed.vehicle) != stiffness(&truth.car.vehicle)
                    || truth.car.slip_angles == SlipAngles::Exact
            );
            assert_eq!(truth.car.imu.vibration_m_s2_per_m_s, vibration);
        }
    }
}
