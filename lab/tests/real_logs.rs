//! The logs of a real car in the folder that `REAL_LOGS` names: none is part of the project.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{
    env, fs,
    path::{Path, PathBuf},
};

use serde::Deserialize;
use singletrack_core::Config;
use singletrack_lab::judge::{Part, WHOLE, judge};
use singletrack_logs::import::import;

fn in_repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Known {
    chosen_on: Vec<String>,
    log: Vec<KnownLog>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KnownLog {
    file: String,
    why: String,
    /// The stops that may end it; without any, it is clean.
    #[serde(default)]
    stops: Vec<String>,
    /// From when to when the cameras jump, in s: the innovations before and after are consistent.
    jump_s: Option<[f64; 2]>,
    /// The noise of the cameras of its day, measured on a part of it.
    position_noise_m: Option<f64>,
    yaw_noise_rad: Option<f64>,
}

/// The raw logs of DART in a folder and those below it, in the order of their paths.
fn raw_logs(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "csv")
                && fs::read_to_string(&path)
                    .unwrap()
                    .starts_with("elapsed time sensors,")
                && fs::read_to_string(&path).unwrap().contains("acc x (IMU)")
            {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

#[test]
fn nothing_stops_the_clean_logs_of_a_real_car_and_their_estimates_are_honest() {
    let folder = env::var_os("REAL_LOGS").unwrap_or_else(|| panic!("REAL_LOGS names no folder"));
    let car = Config::read(&in_repository("tools/real/dart.toml")).unwrap();
    let known: Known =
        toml::from_str(&fs::read_to_string(in_repository("tools/real/dart-logs.toml")).unwrap())
            .unwrap();
    let logs = raw_logs(Path::new(&folder));
    assert!(
        !logs.is_empty(),
        "{} has no raw log of DART",
        folder.display()
    );
    let records = tempfile::tempdir().unwrap();
    let mut wrong = Vec::new();
    println!(
        "{:<62} {:>6} {:>8} {:>6} {:>6} {:>8} {:>8} stops",
        "log", "NIS", "rejected", "speed", "yaw r.", "sideslip", "inside"
    );
    for path in logs {
        let file = path.file_name().unwrap().to_string_lossy().into_owned();
        let record = records.path().join(format!("{file}.mcap"));
        import(
            &[&path],
            &in_repository("tools/real/dart-map.toml"),
            &record,
            |_, _| {},
        )
        .unwrap();
        let special = known.log.iter().find(|log| log.file == file);
        let mut car = car.clone();
        if let Some(noise) = special.and_then(|log| log.position_noise_m) {
            car.estimator.position_noise_m = noise;
        }
        if let Some(noise) = special.and_then(|log| log.yaw_noise_rad) {
            car.estimator.yaw_noise_rad = noise;
        }
        let mut filtered = car.clone();
        filtered.safety_filter.enabled = true;
        let (verdict, _) = judge(&record, &car, WHOLE, |_, _| {}).unwrap();
        let stops: Vec<&str> = verdict.stops.iter().map(|stop| stop.reason).collect();
        let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
        let (nis, within) = (number(verdict.nis_mean), number(verdict.sideslip_within_95));
        let (speed, sideslip) = (
            number(verdict.speed_rms_m_s),
            number(verdict.sideslip_rms_rad),
        );
        println!(
            "{file:<62} {nis:>6.2} {:>8} {speed:>6.3} {:>6.3} {sideslip:>8.4} {:>7.1}% {stops:?}{}{}",
            verdict.rejected,
            number(verdict.yaw_rate_rms_rad_s),
            100.0 * within,
            if known.chosen_on.contains(&file) {
                " (chosen on)"
            } else {
                ""
            },
            special.map_or_else(String::new, |log| format!(" ({})", log.why)),
        );
        let is_consistent = |from_s, to_s| {
            let part = Part {
                from_s,
                to_s,
                ..WHOLE
            };
            let (verdict, _) = judge(&record, &car, part, |_, _| {}).unwrap();
            (2.0..=6.0).contains(&number(verdict.nis_mean))
        };
        let fits = match special {
            Some(log) if !log.stops.is_empty() => stops
                .iter()
                .all(|stop| log.stops.iter().any(|known| known == stop)),
            _ => {
                stops.is_empty()
                    // The filter's assumption of the path's curvature holds.
                    && judge(&record, &filtered, WHOLE, |_, _| {}).unwrap().0.stops.is_empty()
                    && match special.and_then(|log| log.jump_s) {
                        None => (2.0..=6.0).contains(&nis),
                        Some([from, to]) => {
                            is_consistent(0.0, from) && is_consistent(to, f64::INFINITY)
                        }
                    }
                    && speed <= 0.06
                    && sideslip <= 0.022
                    && within >= 0.9
            }
        };
        if !fits || verdict.adopted_ghosts > 0 {
            wrong.push(file);
        }
    }
    assert!(wrong.is_empty(), "not as they should be: {wrong:?}");
}
