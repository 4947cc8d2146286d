//! `singletrack identify`: from the record of a simulated drive to the car in a file, and
//! what it says of records that tell nothing.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::Value;
use singletrack_analysis::identification::Parameter;
use singletrack_control::VehicleParameters;
use singletrack_paper::{
    identify::study::{SCENARIO, StudyPlan, run_study},
    vehicle_file,
};
use singletrack_record::{Entry, Reader, Recorder};
use singletrack_scenario::simulate::{Scenario, simulate_recorded};

use crate::recorded::{self, Script};

fn identify(record: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .arg("identify")
        .arg(record)
        .args(arguments)
        .output()
        .unwrap()
}

fn stdout(output: &Output) -> String {
    assert!(output.status.success(), "{}", said(output));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// What it says of a record that it refuses.
fn refused(record: &Path, arguments: &[&str]) -> String {
    let output = identify(record, arguments);
    assert!(!output.status.success(), "{output:?}");
    assert!(output.stdout.is_empty(), "{output:?}");
    said(&output)
}

/// So much of the drive for identification.
fn weaving(folder: &Path, seconds: f64) -> PathBuf {
    let path = folder.join(format!("weaving-{seconds}.mcap"));
    let mut scenario = Scenario::from_toml(SCENARIO, Path::new("identify-car.toml")).unwrap();
    scenario.run.duration_s = seconds;
    simulate_recorded(&scenario, &path).unwrap();
    path
}

#[test]
fn a_simulated_drive_becomes_a_car_in_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let record = weaving(folder.path(), 24.0);
    let other = weaving(folder.path(), 10.0);
    // A car that is believed to be another one.
    let believed = folder.path().join("believed.toml");
    let paper = VehicleParameters::paper();
    fs::write(
        &believed,
        "[vehicle]\nmass_kg = 1.9\nyaw_inertia_kg_m2 = 0.04\nfront_axle_distance_m = 0.1368\n\
         rear_axle_distance_m = 0.1232\nfriction = 0.25\nfront_cornering_stiffness_n_rad = 90.0\n\
         rear_cornering_stiffness_n_rad = 90.0\n",
    )
    .unwrap();
    let out = folder.path().join("out");
    let output = identify(
        &record,
        &[
            "--validate",
            other.to_str().unwrap(),
            "--vehicle",
            believed.to_str().unwrap(),
            "--out",
            out.to_str().unwrap(),
            "--format",
            "json",
        ],
    );
    let found: Value = serde_json::from_str(&stdout(&output)).unwrap();
    for (index, name, truth, within) in [
        (0, "c_f", paper.front_cornering_stiffness_n_rad, 0.1),
        (1, "c_r", paper.rear_cornering_stiffness_n_rad, 0.03),
        (2, "i_z", paper.yaw_inertia_kg_m2, 0.1),
    ] {
        let estimate = &found["identification"]["estimates"][index];
        assert_eq!(estimate["parameter"], name);
        let value = estimate["value"].as_f64().unwrap();
        assert!((value / truth - 1.0).abs() < within, "{name}: {value}");
        let deviation = estimate["standard_deviation"].as_f64().unwrap();
        assert!(
            (value - truth).abs() < 4.0 * deviation,
            "{name}: {estimate}"
        );
        // It is not that it knows nothing.
        assert!(deviation / truth < 0.01, "{name}: {estimate}");
    }
    let nmpe = |drive: &str| found[drive]["score"]["nmpe"].as_f64().unwrap();
    assert!(nmpe("identification") < 0.05, "{}", nmpe("identification"));
    assert!(nmpe("validation") < 0.05, "{}", nmpe("validation"));
    assert_eq!(
        found["identification"]["warnings"],
        Value::Array(Vec::new())
    );
    assert_eq!(found["start"]["yaw_inertia_kg_m2"], 0.04);

    // The file is a vehicle file, with every digit.
    let vehicle = vehicle_file::read(&out.join("identified.toml")).unwrap();
    assert_eq!(
        found["vehicle"],
        serde_json::to_value(vehicle).unwrap(),
        "{vehicle:?}"
    );
    let json = fs::read_to_string(out.join("identification.json")).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&json).unwrap(), found);
    for name in [
        "inputs",
        "states",
        "validation-inputs",
        "validation-states",
        "residuals",
    ] {
        let svg = fs::read_to_string(out.join(format!("{name}.svg"))).unwrap();
        assert!(svg.contains("<path class="), "{name}");
    }
}

#[test]
fn the_table_is_for_a_person_and_warns_of_a_short_drive() {
    let folder = tempfile::tempdir().unwrap();
    let output = identify(&weaving(folder.path(), 8.0), &["--parameters", "c_r"]);
    let table = stdout(&output);
    assert!(table.contains("parameter"), "{table}");
    assert!(
        table
            .lines()
            .any(|line| line.starts_with("c_r ") && line.contains("N/rad")),
        "{table}"
    );
    assert!(!table.contains("\nc_f"), "{table}");
    assert!(
        table.contains("take as exact: mass (1.9 kg), l_f (0.1368 m), friction (0.25)"),
        "{table}"
    );
    assert!(table.contains("NMPE"), "{table}");
    assert!(
        said(&output).contains("warning: only 8 s of the drive were used"),
        "{}",
        said(&output)
    );
}

#[test]
fn the_estimates_are_within_the_targets_and_near_what_is_possible() {
    let study = run_study(
        &StudyPlan {
            first_seed: 1,
            count: 1,
            ..StudyPlan::default()
        },
        |_| {},
    )
    .unwrap();
    for (summary, within) in study.summaries().iter().zip([0.1, 0.03, 0.1]) {
        let name = summary.parameter;
        assert!(
            summary.worst_relative_error < within / 10.0,
            "{name}: {summary:?}"
        );
        assert!(
            summary.deviation < 4.0 * summary.bound,
            "{name}: {summary:?}"
        );
        let stated = summary.stated_deviation / summary.bound;
        assert!((0.9..2.0).contains(&stated), "{name}: {summary:?}");
    }
    let nmpe = study.nmpe();
    assert!(nmpe.iter().all(|nmpe| *nmpe < 0.04), "{nmpe:?}");
    for result in &study.seeds {
        assert!(result.warnings.is_empty(), "{result:?}");
        let slowest = result.estimate(Parameter::ServoLag).unwrap();
        assert!((slowest.value - 0.04).abs() < 1e-3, "{slowest:?}");
    }
}

#[test]
fn records_that_tell_nothing_are_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing.mcap");
    let text = refused(&missing, &[]);
    assert!(text.contains("missing.mcap"), "{text}");

    let garbage = folder.path().join("garbage.mcap");
    fs::write(&garbage, "no record").unwrap();
    let text = refused(&garbage, &[]);
    assert!(text.contains("garbage.mcap"), "{text}");

    // The car never drove.
    let idle = folder.path().join("idle.mcap");
    recorded::write(
        &idle,
        &Script {
            drives: Vec::new(),
            ..Script::default()
        },
    );
    let text = refused(&idle, &[]);
    assert!(text.contains("there is no drive in this record"), "{text}");

    // It drove, and the record has nothing of the board's telemetry.
    let blind = folder.path().join("blind.mcap");
    recorded::write(&blind, &Script::default());
    let text = refused(&blind, &[]);
    assert!(
        text.contains("drive 1: there are 0 poses of the motion capture")
            || text.contains("drive 1: there are 0 samples of the IMU"),
        "{text}"
    );
    let text = refused(&blind, &["--drive", "3"]);
    assert!(text.contains("choose --drive from 1 to 1"), "{text}");

    // The paper's circle is driven at 0.4 m/s.
    let slow = folder.path().join("slow.mcap");
    let circle = include_str!("../../scenarios/circle-car.toml");
    let mut circle = Scenario::from_toml(circle, Path::new("circle-car.toml")).unwrap();
    circle.run.duration_s = 10.0;
    circle.start.point_p_m = [1.0, 0.0];
    simulate_recorded(&circle, &slow).unwrap();
    let text = refused(&slow, &[]);
    assert!(
        text.contains("never faster than") && text.contains("drive faster, 1.5 m/s or more"),
        "{text}"
    );

    let short = weaving(folder.path(), 4.0);
    let text = refused(&short, &[]);
    assert!(text.contains("are needed: drive longer"), "{text}");

    // Without the IMU.
    let numb = folder.path().join("numb.mcap");
    let reader = Reader::open(&short).unwrap();
    let mut recorder = Recorder::create(&numb, reader.meta()).unwrap();
    for entry in reader {
        let entry = entry.unwrap();
        if !matches!(entry, Entry::Telemetry(_)) {
            recorder.write(&entry).unwrap();
        }
    }
    recorder.finish().unwrap();
    let text = refused(&numb, &[]);
    assert!(text.contains("there are 0 samples of the IMU"), "{text}");
}

#[test]
fn a_foreign_vehicle_file_is_kept_and_a_bad_folder_is_refused_first() {
    let folder = tempfile::tempdir().unwrap();
    // Refused before the record is even looked at.
    let record = folder.path().join("none.mcap");
    let mine = folder.path().join("identified.toml");
    fs::write(&mine, "# measured with scales\n[vehicle]\n").unwrap();
    let out = ["--out", folder.path().to_str().unwrap()];
    let error = refused(&record, &out);
    assert!(
        error.contains("identified.toml") && error.contains("--out"),
        "{error}"
    );
    assert!(fs::read_to_string(&mine).unwrap().contains("scales"));
    let file = mine.join("below");
    let error = refused(&record, &["--out", file.to_str().unwrap()]);
    assert!(
        error.contains("can't write") && error.contains("--out"),
        "{error}"
    );
}

#[test]
fn options_that_make_no_sense_are_refused_by_name() {
    let nowhere = Path::new("nowhere.mcap");
    let text = refused(nowhere, &["--parameters", "c_f,c_x"]);
    assert!(
        text.contains("c_x") && text.contains("choose from c_f, c_r, i_z"),
        "{text}"
    );
    let text = refused(nowhere, &["--least-speed=-1"]);
    assert!(text.contains("--least-speed"), "{text}");
    let text = refused(nowhere, &["--vehicle", "nothing.toml"]);
    assert!(text.contains("nothing.toml"), "{text}");
}

#[test]
fn a_damaged_record_is_used_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let record = weaving(folder.path(), 18.0);
    let mut bytes = fs::read(&record).unwrap();
    let at = bytes.len() / 2;
    for byte in &mut bytes[at..at + 2_000] {
        *byte ^= 0x5a;
    }
    let damaged = folder.path().join("damaged.mcap");
    fs::write(&damaged, bytes).unwrap();
    let output = identify(&damaged, &["--format", "json"]);
    let found: Value = serde_json::from_str(&stdout(&output)).unwrap();
    let seconds = found["identification"]["seconds"].as_f64().unwrap();
    assert!((5.0..8.0).contains(&seconds), "{seconds}");
    assert!(
        said(&output).contains("is damaged after"),
        "{}",
        said(&output)
    );
}
