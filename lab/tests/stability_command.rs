//! `singletrack stability` as a person or a script sees it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

fn vehicle(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../tools/vehicles")
        .join(name)
}

fn stability(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_singletrack-lab"))
        .arg("stability")
        .args(arguments)
        .output()
        .unwrap()
}

fn printed(arguments: &[&str]) -> String {
    let output = stability(arguments);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    String::from_utf8(output.stdout).unwrap()
}

/// The rows of a CSV with this header.
fn rows(arguments: &[&str], header: &str) -> Vec<Vec<f64>> {
    let text = printed(arguments);
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some(header));
    lines
        .map(|line| {
            line.split(',')
                .map(|field| field.parse().unwrap_or(f64::NAN))
                .collect()
        })
        .collect()
}

const HOPF: &str = "speed_m_s,dl_hopf_m,omega_rad_s,l1_kuznetsov,l1_matcont";

#[test]
fn the_hopf_curve_has_a_row_for_every_speed_with_the_papers_threshold_first() {
    let curve = rows(&["hopf", "--law", "velocity-point"], HOPF);
    assert_eq!(curve.len(), 159);
    assert_eq!((curve[0][0], curve[158][0]), (0.1, 8.0));
    assert!(
        (curve[0][1] - 0.000_135_977_266_268_669).abs() < 1e-12,
        "{:?}",
        curve[0]
    );
    for row in &curve {
        assert!(row[3] > 0.0, "subcritical: {row:?}");
        assert!((row[4] / (row[2] * row[3]) - 1.0).abs() < 1e-12, "{row:?}");
    }
}

#[test]
fn json_says_of_which_car_it_is_and_all_that_is_known_of_a_point() {
    let text = printed(&[
        "hopf",
        "--law",
        "front-point",
        "--speeds",
        "1:2:0.5",
        "--format",
        "json",
    ]);
    let document: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(document["vehicle"]["mass_kg"], 1.9);
    assert_eq!(document["law"], "front-point");
    assert_eq!(
        document["meaningful_dl_m"],
        serde_json::json!([-0.1368, 0.1232])
    );
    let points = document["points"].as_array().unwrap();
    assert_eq!(points.len(), 3);
    assert_eq!(points[1]["speed_m_s"], 1.5);
    assert_eq!(points[1]["criticality"], "subcritical");
    assert_eq!(points[1]["ends_stability"], true);
    assert!(points[1]["dre_ddl_per_s_m"].as_f64().unwrap() < 0.0);
}

/// The JSON of a command that also writes a note.
fn printed_document(arguments: &[&str]) -> serde_json::Value {
    let output = stability(&[arguments, &["--format", "json"]].concat());
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn eigenvalues_come_over_speeds_and_deviations_by_ascending_real_part() {
    let map = rows(
        &[
            "eigenvalues",
            "--law",
            "front-point",
            "--speeds",
            "1:2:1",
            "--dl",
            "-0.1:0.1:0.1",
        ],
        "speed_m_s,dl_m,re1,im1,re2,im2,re3,im3,re4,im4",
    );
    let points: Vec<_> = map.iter().map(|row| (row[0], row[1])).collect();
    assert_eq!(
        points,
        [
            (1.0, -0.1),
            (1.0, 0.0),
            (1.0, 0.1),
            (2.0, -0.1),
            (2.0, 0.0),
            (2.0, 0.1)
        ]
    );
    for row in &map {
        assert!(
            row[2] <= row[4] && row[4] <= row[6] && row[6] <= row[8],
            "{row:?}"
        );
    }
    let map = rows(
        &[
            "eigenvalues",
            "--law",
            "velocity-point",
            "--speeds",
            "1",
            "--dl",
            "0",
        ],
        "speed_m_s,dl_m,re1,im1,re2,im2,re3,im3",
    );
    // With the right parameters one of them is the linearised point's, -v/p.
    assert!((map[0][6] + 1.0 / 0.35).abs() < 1e-9, "{map:?}");
}

#[test]
fn the_region_is_stable_where_all_eigenvalues_are_left_of_zero() {
    let region = rows(
        &["region", "--law", "velocity-point", "--speeds", "0.5:8:0.5"],
        "speed_m_s,dl_m,largest_re_per_s,stable",
    );
    assert_eq!(region.len(), 16 * 121);
    for row in &region {
        assert_eq!(row[3] == 1.0, row[2] < 0.0, "{row:?}");
    }
    assert!(region.iter().any(|row| row[3] == 1.0) && region.iter().any(|row| row[3] == 0.0));
}

#[test]
fn the_sampled_loop_leaves_a_field_empty_where_no_limit_was_found() {
    let text = printed(&[
        "sampled",
        "--law",
        "front-point",
        "--speeds",
        "0.1:2.1:2",
        "--dl",
        "0",
    ]);
    let lines: Vec<_> = text.lines().collect();
    assert_eq!(
        lines[0],
        "speed_m_s,dl_m,spectral_radius,delay_margin_s,longest_constant_interval_s"
    );
    assert!(
        lines[1].starts_with("0.1,0,0.99") && lines[1].ends_with(",,"),
        "{}",
        lines[1]
    );
    let fast: Vec<f64> = lines[2]
        .split(',')
        .map(|field| field.parse().unwrap())
        .collect();
    assert!(
        fast[3] > 0.05 && fast[3] < 0.1 && fast[4] > 0.3 && fast[4] < 0.8,
        "{fast:?}"
    );
}

#[test]
fn poses_that_are_seldom_lower_the_speed_and_lengthen_p() {
    let limit = |command: &str, header: &str, more: [&str; 2]| {
        let arguments = [command, "--law", "front-point", "--steering-lag-ms", "40"];
        let of = |ticks: &str| {
            let arguments = [&arguments[..], &more, &["--marker-interval", ticks]].concat();
            *rows(&arguments, header).last().unwrap().last().unwrap()
        };
        [of("1"), of("60")]
    };
    let header = "point_distance_m,dl_m,delay_ms,first_unstable_m_s";
    let [often, seldom] = limit(
        "first-unstable-speed",
        header,
        ["--distances", "0.35:0.35:0.1"],
    );
    assert!(seldom < 0.8 * often, "{seldom} and {often} m/s");
    let header = "speed_m_s,delay_ms,least_p_m";
    let [often, seldom] = limit("least-p", header, ["--speeds", "3:3:1"]);
    assert!(seldom > 1.2 * often, "{seldom} and {often} m");
}

#[test]
fn nothing_of_the_papers_car_is_in_the_numbers_of_another() {
    let file = vehicle("bmw-320i.toml");
    let file = file.to_str().unwrap();
    let arguments = ["--law", "velocity-point", "--speeds", "5:30:5"];
    let paper = rows(&[&["hopf"], &arguments[..]].concat(), HOPF);
    let bmw = rows(
        &[
            &["hopf", "--vehicle", file, "--point-distance", "3"],
            &arguments[..],
        ]
        .concat(),
        HOPF,
    );
    assert_eq!(paper.len(), bmw.len());
    assert!(
        paper
            .iter()
            .zip(&bmw)
            .all(|(paper, bmw)| paper[1..] != bmw[1..])
    );
}

#[test]
fn an_invalid_argument_is_refused_with_its_name_and_the_fix() {
    let folder = tempfile::tempdir().unwrap();
    let broken = folder.path().join("car.toml");
    fs::write(&broken, "[vehicle]\nmass = 1.9\n").unwrap();
    let broken = broken.to_str().unwrap();
    for (arguments, words) in [
        (
            &["hopf", "--law", "front-point", "--speeds", "0:1:0.5"][..],
            "speed is 0 m/s",
        ),
        (
            &["hopf", "--law", "front-point", "--speeds", "1:2"],
            "A:B:STEP",
        ),
        (
            &["hopf", "--law", "pure-pursuit"],
            "front-point, velocity-point",
        ),
        (
            &["sampled", "--law", "front-point", "--predict"],
            "the prediction is of a servo",
        ),
        (
            &["hopf", "--law", "front-point", "--point-distance", "0"],
            "point distance p is 0 m",
        ),
        (
            &[
                "eigenvalues",
                "--law",
                "front-point",
                "--dl",
                "0.1:-0.1:0.1",
            ],
            "smaller value first",
        ),
        (
            &["region", "--law", "front-point", "--vehicle", broken],
            "mass",
        ),
        (
            &["sampled", "--law", "front-point", "--delay-ms", "-1"],
            "delay",
        ),
        (
            &["sampled", "--law", "front-point", "--period-ms", "0"],
            "control period",
        ),
    ] {
        let output = stability(arguments);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{arguments:?}");
        assert!(error.contains(words), "{arguments:?}: {error}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
}

#[test]
fn a_reader_that_has_seen_enough_is_no_error() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_singletrack-lab"))
        .args(["stability", "eigenvalues", "--law", "front-point"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn the_summary_says_what_the_paper_claims_and_for_which_car_it_does_not_hold() {
        let paper = printed(&["summary"]);
        assert!(
            paper.contains("stability ends at dl = -0.142728 m"),
            "{paper}"
        );
        assert!(
            paper.contains("stable over the whole meaningful range at every speed"),
            "{paper}"
        );
        assert!(
            paper.contains("0.1 m/s: Hopf at dl = 0.000136 m, "),
            "{paper}"
        );
        let file = vehicle("f1tenth.toml");
        let other = printed(&["summary", "--vehicle", file.to_str().unwrap()]);
        assert!(
            other.contains("meaningful range up to 12.338 m/s, NOT beyond"),
            "{other}"
        );
    }

    #[test]
    fn cycles_come_in_the_order_of_their_branch_with_its_folds_as_a_note() {
        let output = stability(&[
            "cycles",
            "--law",
            "front-point",
            "--speed",
            "3.4",
            "--dl",
            "-0.28:-0.26:0.01",
            "--format",
            "csv",
        ]);
        let table = String::from_utf8(output.stdout).unwrap();
        let mut lines = table.lines();
        assert_eq!(
            lines.next(),
            Some("dl_m,amplitude_rad,period_s,multiplier,stable")
        );
        let rows: Vec<Vec<f64>> = lines
            .map(|line| {
                line.split(',')
                    .map(|field| field.parse().unwrap())
                    .collect()
            })
            .collect();
        let deviations: Vec<f64> = rows.iter().map(|row| row[0]).collect();
        assert_eq!(deviations, [-0.28, -0.27, -0.27]);
        for row in &rows {
            assert!(row[1] > 0.9 && row[3] > 1.0 && row[4] == 0.0, "{row:?}");
        }
        let note = String::from_utf8(output.stderr).unwrap();
        assert!(
            note.contains("branch from dl = -0.438905 m, fold at dl = -0.269149 m"),
            "{note}"
        );
        let document = printed_document(&[
            "cycles",
            "--law",
            "velocity-point",
            "--speed",
            "2",
            "--dl",
            "0.1",
            "--tyres",
            "saturating",
            "--max-steering",
            "0.2",
        ]);
        let cycle = &document["points"][0];
        assert_eq!(
            (&cycle["amplitude_rad"], &cycle["stable"]),
            (&0.2.into(), &true.into())
        );
    }

    #[test]
    fn the_basin_comes_over_speed_and_p_and_narrows_with_the_speed() {
        let basin = rows(
            &[
                "basin",
                "--law",
                "front-point",
                "--speeds",
                "2.5:3:0.5",
                "--distances",
                "0.3:0.4:0.1",
                "--tyres",
                "saturating",
                "--max-steering",
                "0.45",
                "--steering-lag-ms",
                "40",
                "--steering-dead-time-ms",
                "20",
            ],
            "speed_m_s,point_distance_m,yaw_rad,beyond_amplitude_rad",
        );
        let points: Vec<_> = basin.iter().map(|row| (row[0], row[1])).collect();
        assert_eq!(points, [(2.5, 0.3), (2.5, 0.4), (3.0, 0.3), (3.0, 0.4)]);
        assert!(
            basin[0][2] < basin[1][2],
            "a larger p is the lower gain: {basin:?}"
        );
        assert!(
            basin[3][2] < basin[1][2] && basin[2][2] < basin[0][2],
            "{basin:?}"
        );
        let refused = stability(&[
            "basin",
            "--law",
            "velocity-point",
            "--steering-lag-ms",
            "40",
        ]);
        let error = String::from_utf8(refused.stderr).unwrap();
        assert!(error.contains("front-point law"), "{error}");
    }

    #[test]
    fn a_small_region_of_attraction_is_proved_within_the_simulated_basin() {
        let header = "speed_m_s,level,proved_yaw_rad,simulated_yaw_rad,boxes,time_s";
        let arguments = ["attraction", "--law", "front-point", "--speeds", "2"];
        let region = rows(&[&arguments[..], &["--most-yaw", "0.005"]].concat(), header);
        assert!((region[0][2] - 0.005).abs() < 1e-9, "{region:?}");
        assert!(region[0][3] > 1.5, "{region:?}");
        let refused = stability(&["attraction", "--law", "velocity-point"]);
        let error = String::from_utf8(refused.stderr).unwrap();
        assert!(error.contains("front-point law"), "{error}");
    }

    #[test]
    fn a_servo_bounds_the_speed_and_p_and_a_prediction_lifts_the_bound() {
        let law = ["--law", "front-point"];
        let first = |options: &[&str]| {
            let arguments = [&["first-unstable-speed"], &law[..], options].concat();
            rows(
                &arguments,
                "point_distance_m,dl_m,delay_ms,first_unstable_m_s",
            )
        };
        let speeds = first(&["--distances", "0.05:0.35:0.3"]);
        assert!((speeds[0][3] - 1.28).abs() < 0.02, "{speeds:?}");
        assert!((speeds[1][3] - 3.79).abs() < 0.02, "{speeds:?}");
        let fresh = first(&["--distances", "0.35", "--yaw-rate-age-ms", "0"]);
        assert!(fresh[0][3] > 1.1 * speeds[1][3], "{fresh:?}");
        let compensated = first(&["--distances", "0.35", "--compensate"]);
        assert!(compensated[0][3] > 2.0 * speeds[1][3], "{compensated:?}");
        let slower = first(&["--distances", "0.35", "--delays-ms", "7:27:20"]);
        assert_eq!(slower.len(), 2);
        assert!(slower[1][3] < 0.8 * slower[0][3], "{slower:?}");
        let arguments = [
            &["first-unstable-speed"],
            &law[..],
            &["--distances", "0.35", "--predict"],
        ]
        .concat();
        let predicted = printed(&arguments);
        assert!(predicted.ends_with("\n0.35,0,7,\n"), "{predicted}");

        let least = rows(
            &[&["least-p"], &law[..], &["--speeds", "1:3:1"]].concat(),
            "speed_m_s,delay_ms,least_p_m",
        );
        for (row, expected) in least.iter().zip([0.033, 0.115, 0.245]) {
            assert!((row[2] - expected).abs() < 1e-3, "{least:?}");
        }
        let summary = printed(&["summary"]);
        assert!(
            summary.contains("stable with dl = 0: up to 3.79 m/s, NOT beyond"),
            "{summary}"
        );
    }
}
