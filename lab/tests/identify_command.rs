//! `singletrack identify`: from the record of a simulated drive to the car in a file, and
//! what it says of records that tell nothing.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::Value;
use singletrack_analysis::identification::Parameter;
use singletrack_control::{
    RelaxedSingleTrack, SingleTrackState, SlipAngles, Tyres, VehicleParameters,
};
use singletrack_core::Config;
use singletrack_lab::vehicle_file;
use singletrack_logs::import::import;
use singletrack_pilot::Event;
use singletrack_record::{Entry, Reader, Recorder};
use singletrack_scenario::simulate::{Scenario, simulate_recorded};

use crate::{
    recorded::{self, Script},
    study::{SCENARIO, StudyPlan, run_study},
};

fn identify(record: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack-lab"))
        .arg("identify")
        .arg(record)
        .args(arguments)
        .output()
        .unwrap()
}

fn in_repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
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

/// A log of another program as CSV: the car of `tools/real/dart.toml` weaves, its board sends ten samples a
/// second, and the rows between repeat them.
fn csv_log(seconds: f64, phase: f64) -> String {
    const STEP: f64 = 0.001;
    let car = Config::read(&in_repository("tools/real/dart.toml")).unwrap();
    let model = RelaxedSingleTrack::new(car.vehicle);
    let [forward, left] = car.motion_capture.marker_offset_m;
    let mut state = SingleTrackState::default();
    let mut steering = 0.0;
    let mut held = String::from("0,0,0,0,0");
    // Uniform between -0.5 and 0.5.
    let mut count = 0.0;
    let mut noise = || {
        count += 1.0;
        (f64::sin(12.9898 * count + phase) * 43_758.545_3).rem_euclid(1.0) - 0.5
    };
    let mut log = String::from("t,x,y,yaw,clock,ax,ay,w,v,steer\n");
    for tick in 0..(seconds / STEP) as u32 {
        let time = f64::from(tick) * STEP;
        let angle = |time: f64| 0.15 * (3.1 * time + phase).sin() + 0.1 * (7.3 * time).sin();
        let speed = 1.4 + 0.2 * (0.9 * time + phase).sin();
        let along = 0.18 * (0.9 * time + phase).cos();
        let rate = model.derivative(&state, speed, steering);
        let across = speed * (rate.sideslip + state.yaw_rate);
        let (sin, cos) = state.sideslip.sin_cos();
        if tick % 100 == 0 {
            let [ax, ay] = [along * cos - across * sin, along * sin + across * cos];
            let [ax, ay] = [ax + 0.3 * noise(), ay + 0.3 * noise()];
            let gyro = 1.02 * state.yaw_rate + 0.05 * noise();
            held = format!("{time},{ax},{ay},{gyro},{speed}");
        }
        if tick % 10 == 0 {
            let (s, c) = state.yaw.sin_cos();
            let x = state.x + c * forward - s * left;
            let y = state.y + s * forward + c * left;
            let yaw = state.yaw + car.motion_capture.marker_yaw_rad;
            let [x, y, yaw] = [x + 5e-4 * noise(), y + 5e-4 * noise(), yaw + 4e-3 * noise()];
            writeln!(log, "{time},{x},{y},{yaw},{held},{}", angle(time)).unwrap();
        }
        // The servo's command is that of the last row.
        let target = angle(f64::from(tick / 10 * 10) * STEP);
        steering += STEP / 0.08 * (target - steering);
        state.x += STEP * rate.x;
        state.y += STEP * rate.y;
        state.yaw += STEP * rate.yaw;
        state.yaw_rate += STEP * rate.yaw_rate;
        state.sideslip += STEP * rate.sideslip;
    }
    log
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
    let circle = include_str!("../../tools/scenarios/circle-car.toml");
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

    // Without IMU and board: neither telemetry nor what the ticks took in of it.
    let numb = folder.path().join("numb.mcap");
    let reader = Reader::open(&short).unwrap();
    let mut recorder = Recorder::create(&numb, &reader.meta).unwrap();
    for entry in reader {
        let mut entry = entry.unwrap();
        if let Entry::Tick(tick) = &mut entry {
            tick.events
                .retain(|event| !matches!(event, Event::Board(_)));
        }
        if !matches!(entry, Entry::Telemetry(_)) {
            recorder.write(&entry).unwrap();
        }
    }
    recorder.finish().unwrap();
    let text = refused(&numb, &[]);
    for words in [
        "it has no accelerometer",
        "no telemetry of a board",
        "drive longer",
    ] {
        assert!(text.contains(words), "{text}");
    }
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

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

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
        for (index, role) in ["identification", "validation"].iter().enumerate() {
            let log = &found["logs"][index];
            assert_eq!(log["role"], *role);
            let nmpe = log["nmpe"].as_f64().unwrap();
            // Nearly all of it is the vibration of the IMU.
            assert!(nmpe < 0.35, "{role}: {nmpe}");
            for output in ["fit_yaw_rate_percent", "fit_sideslip_percent"] {
                let fit = log[output].as_f64().unwrap();
                assert!((80.0..100.0).contains(&fit), "{role}, {output}: {fit}");
            }
        }
        assert_eq!(found["converged"], true);
        assert_eq!(found["criterion"], "prediction");
        let inertia = &found["parameters"]["i_z"];
        assert!(inertia["low"].as_f64() < inertia["value"].as_f64());
        assert!(inertia["value"].as_f64() < inertia["high"].as_f64());
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

    /// Pacejka's tyres and exact slip angles, fitted with a hyperbolic tangent and small angles: the
    /// estimates are a few per cent off, far more than their intervals say, and the fit warns.
    #[test]
    fn the_estimates_of_a_car_of_another_structure_stay_near_its_parameters() {
        let plan = StudyPlan {
            first_seed: 1,
            count: 1,
            tyre_curve: Tyres::MagicFormula,
            slip_angles: SlipAngles::Exact,
            ..StudyPlan::default()
        };
        let study = run_study(&plan).unwrap();
        for (summary, within) in study.summaries().iter().zip([0.06, 0.03, 0.06]) {
            let name = summary.parameter.name();
            let error = summary.worst_relative_error;
            println!("{name}: {:.2} % off", 100.0 * error);
            assert!(error < within, "{name}: {summary:?}");
            // It is another car: with the structure of the model they are within 0.5 %.
            assert!(error > 0.005, "{name}: {summary:?}");
        }
        let warnings = study.seeds.iter().flat_map(|seed| &seed.warnings);
        let unexplained = "forces that the model does not explain";
        assert_eq!(
            warnings
                .filter(|warning| warning.to_string().contains(unexplained))
                .count(),
            1
        );
        // The simulation of another drive is as good as ever: it does not show the error. Nearly all of
        // it is the vibration of the IMU.
        assert!(
            study.nmpe().iter().all(|nmpe| *nmpe < 0.35),
            "{:?}",
            study.nmpe()
        );
    }

    /// With small ones, two of the three are 2.9 and 4.9 % off.
    #[test]
    fn exact_slip_angles_identify_a_car_that_has_them() {
        let plan = StudyPlan {
            first_seed: 101,
            count: 1,
            slip_angles: SlipAngles::Exact,
            fitted_slip_angles: SlipAngles::Exact,
            ..StudyPlan::default()
        };
        let study = run_study(&plan).unwrap();
        for (summary, within) in study.summaries().iter().zip([0.01, 0.01, 0.01]) {
            println!("{summary:?}");
            assert!(summary.worst_relative_error < within, "{summary:?}");
        }
    }

    #[test]
    fn the_estimates_are_within_the_targets_and_near_what_is_possible() {
        let plan = StudyPlan {
            first_seed: 1,
            count: 1,
            ..StudyPlan::default()
        };
        let study = run_study(&plan).unwrap();
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
            // No deviation below 0.15 % of the value is stated.
            let least = summary.bound.hypot(1.5e-3 * summary.truth);
            let stated = summary.stated_deviation / least;
            assert!((0.9..2.0).contains(&stated), "{name}: {summary:?}");
        }
        let nmpe = study.nmpe();
        assert!(nmpe.iter().all(|nmpe| *nmpe < 0.35), "{nmpe:?}");
        for result in &study.seeds {
            assert!(result.warnings.is_empty(), "{result:?}");
            let slowest = result.estimate(Parameter::ServoLag).unwrap();
            assert!((slowest.value - 0.04).abs() < 1e-3, "{slowest:?}");
        }
    }

    #[test]
    fn the_log_of_another_program_identifies_its_car_and_is_validated_on_another() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            path
        };
        let map = write(
            "map.toml",
            "[time]\ncolumn = \"t\"\nunit = \"s\"\nunix = false\n\
             [pose]\nx = \"x\"\ny = \"y\"\nyaw = \"yaw\"\n\
             [imu]\nforward_acceleration = \"ax\"\nleft_acceleration = \"ay\"\nyaw_rate = \"w\"\n\
             new_when_changes = \"clock\"\n\
             [motor]\nspeed = \"v\"\nnew_when_changes = \"clock\"\n\
             [steering]\ncolumn = \"steer\"\nradians_per_unit = 1.0\n",
        );
        let record = |name: &str, log: &str| {
            let csv = write(&format!("{name}.csv"), log);
            let path = folder.path().join(format!("{name}.mcap"));
            import(&[&csv], &map, &path, |_, _| {}).unwrap();
            path
        };
        let [first, second, other] = [("first", 0.0), ("second", 1.0), ("other", 2.0)]
            .map(|(name, phase)| record(name, &csv_log(16.0, phase)));
        let text = refused(&first, &[]);
        assert!(
            text.contains("was imported") && text.contains("--config"),
            "{text}"
        );
        let text = refused(&first, &["--validate", first.to_str().unwrap()]);
        assert!(text.contains("is given twice"), "{text}");
        let config = in_repository("tools/real/dart.toml");
        let truth = Config::read(&config).unwrap().vehicle;
        let start = VehicleParameters {
            front_cornering_stiffness_n_rad: 1.4 * truth.front_cornering_stiffness_n_rad,
            rear_cornering_stiffness_n_rad: 0.7 * truth.rear_cornering_stiffness_n_rad,
            ..truth
        };
        let start = write(
            "start.toml",
            &format!("[vehicle]\n{}", toml::to_string(&start).unwrap()),
        );
        let output = Command::new(env!("CARGO_BIN_EXE_singletrack-lab"))
            .arg("identify")
            .args([&first, &second, Path::new("--config"), &config])
            .args([
                Path::new("--vehicle"),
                &start,
                Path::new("--validate"),
                &other,
            ])
            .args(["--format", "json"])
            .output()
            .unwrap();
        let found: Value = serde_json::from_str(&stdout(&output)).unwrap();
        assert!(
            said(&output).contains("no telemetry of a board"),
            "{}",
            said(&output)
        );
        for (name, truth) in [
            ("c_f", truth.front_cornering_stiffness_n_rad),
            ("c_r", truth.rear_cornering_stiffness_n_rad),
            ("gyro_scale", 1.02),
        ] {
            let value = found["parameters"][name]["value"].as_f64().unwrap();
            assert!((value / truth - 1.0).abs() < 0.03, "{name}: {value}");
        }
        let logs = found["logs"].as_array().unwrap();
        let roles: Vec<_> = logs
            .iter()
            .map(|log| log["role"].as_str().unwrap())
            .collect();
        assert_eq!(roles, ["identification", "identification", "validation"]);
        for log in logs {
            for output in ["fit_yaw_rate_percent", "fit_sideslip_percent"] {
                let fit = log[output].as_f64().unwrap();
                assert!(fit > 85.0, "{output}: {log}");
            }
        }
    }
}
