//! What the pilot would have said of a drive: a car that moves as a rigid body on circles, logged as
//! DART logs, with the noise of its sensors.

use std::{f64::consts::TAU, fmt::Write as _, fs, path::Path};

use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng as _, SeedableRng as _},
};
use singletrack_core::Config;
use singletrack_lab::judge::{Part, Verdict, WHOLE, judge};
use singletrack_logs::import::import;

/// A file of the repository.
pub(crate) fn in_repository(path: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

pub(crate) fn dart() -> Config {
    Config::read(&in_repository("tools/real/dart.toml")).unwrap()
}

/// The header of a raw log of DART.
const HEADER: &str = "elapsed time sensors,current,voltage,acc x (IMU),acc y (IMU),W (IMU),\
vel encoder,safety_value,throttle,steering,vicon time,vicon x,vicon y,vicon yaw\n";

struct Noise(ChaCha8Rng);

impl Noise {
    /// Uniform in 0 to 1.
    fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Normal, with this standard deviation.
    fn normal(&mut self, deviation: f64) -> f64 {
        let sum: f64 = (0..12).map(|_| self.uniform()).sum();
        deviation * (sum - 6.0)
    }
}

/// What is wrong in a log at a time (s): changes the pose.
type Fault<'a> = dyn Fn(f64, &mut [f64; 3]) + 'a;

/// A minute of a car that stands, starts off, and drives on a circle with 1.2 m/s.
fn log(seed: u64, fault: &Fault<'_>) -> String {
    const RADIUS: f64 = 1.3;
    const SPEED: f64 = 1.2;
    let mut noise = Noise(ChaCha8Rng::seed_from_u64(seed));
    let mut text = HEADER.to_owned();
    let speed_at = |time: f64| (0.8 * (time - 5.0)).clamp(0.0, SPEED);
    let (mut angle, mut held) = (0.0, String::new());
    for row in 0..3_000_u32 {
        let time = f64::from(row) * 0.01;
        angle += 0.01 * speed_at(time) / RADIUS;
        // The rear axle does not slip: the yaw lags behind the course of G by the sideslip.
        let sideslip = (0.0930 / RADIUS).asin();
        let yaw = angle + TAU / 4.0 - sideslip;
        if row.is_multiple_of(10) {
            let before = time - 0.05;
            let speed = speed_at(before);
            let forward = (speed_at(before + 0.005) - speed_at(before - 0.005)) / 0.01;
            let rate = speed / RADIUS;
            // Along the course and across it, in the axes of the car.
            let (s, c) = sideslip.sin_cos();
            let across = speed * rate;
            let [ax, ay] = [c * forward - s * across, s * forward + c * across];
            let vibration = 0.05 + 0.6 * speed;
            held = format!(
                "{:.3},0,0,{:.3},{:.3},{:.5},{:.3},{},0.2,{:.3}",
                500.0 + time,
                ax + noise.normal(vibration),
                ay + noise.normal(vibration),
                1.025 * rate + noise.normal(0.02 + 0.03 * speed),
                speed_at(time - 0.04) * sideslip.cos() + noise.normal(0.01),
                u8::from(time > 1.0),
                if time > 5.0 { 0.28 } else { 0.0 },
            );
        }
        let (s, c) = yaw.sin_cos();
        let (ahead, left) = (0.022, -0.010);
        let mut pose = [
            RADIUS * angle.cos() + c * ahead - s * left + noise.normal(1e-4),
            RADIUS * angle.sin() + s * ahead + c * left + noise.normal(1e-4),
            yaw - 0.0077 + noise.normal(1.2e-3),
        ];
        fault(time, &mut pose);
        let [x, y, yaw] = pose;
        let stamp = 1_700_000_000.0 + time + noise.normal(2e-4);
        writeln!(text, "{held},{stamp:.6},{x:.6},{y:.6},{yaw:.6}").unwrap();
    }
    text
}

fn judged(fault: &Fault<'_>) -> Verdict {
    judged_with(&log(7, fault), &dart_map())
}

fn dart_map() -> String {
    fs::read_to_string(in_repository("tools/real/dart-map.toml")).unwrap()
}

fn judged_with(log: &str, map: &str) -> Verdict {
    let folder = tempfile::tempdir().unwrap();
    let (csv, record) = (
        folder.path().join("log.csv"),
        folder.path().join("log.mcap"),
    );
    let file = folder.path().join("map.toml");
    fs::write(&csv, log).unwrap();
    fs::write(&file, map).unwrap();
    import(&[&csv], &file, &record, |_, _| {}).unwrap();
    let (verdict, figure) = judge(&record, &dart(), WHOLE, |_, _| {}).unwrap();
    assert!(figure.to_svg().ends_with("</svg>\n"));
    verdict
}

fn reasons(verdict: &Verdict) -> Vec<&'static str> {
    verdict.stops.iter().map(|stop| stop.reason).collect()
}

#[test]
fn a_clean_drive_has_no_stop_and_an_honest_estimate() {
    let verdict = judged(&|_, _| {});
    assert_eq!(reasons(&verdict), [""; 0]);
    assert_eq!(verdict.rejected, 0);
    assert!(
        (2_980..=3_000).contains(&verdict.poses),
        "{}",
        verdict.poses
    );
    assert!((29.8..30.0).contains(&verdict.duration_s));
    let nis = verdict.nis_mean.unwrap();
    assert!((1.0..6.0).contains(&nis), "{nis}");
    let sideslip = verdict.sideslip_rms_rad.unwrap();
    assert!(sideslip < 0.022, "{sideslip}");
    let yaw_rate = verdict.yaw_rate_rms_rad_s.unwrap();
    assert!(yaw_rate < 0.06, "{yaw_rate}");
    let within = verdict.sideslip_within_95.unwrap();
    assert!(within > 0.9, "{within}");
    assert!(
        verdict
            .not_judged
            .iter()
            .any(|what| what == "the commanded speed")
    );
    assert_eq!(verdict.findings, [""; 0]);
}

#[test]
fn a_log_without_an_imu_or_with_a_gyro_alone_is_judged_and_says_what_is_not() {
    let log = log(7, &|_, _| {});
    let map = dart_map();
    let (before, imu) = map.split_once("[imu]").unwrap();
    let (imu, after) = imu.split_once("[motor]").unwrap();
    let gyro: Vec<&str> = imu
        .lines()
        .filter(|line| !line.contains("_acceleration"))
        .collect();
    let gyro = gyro.join("\n");
    for (map, unjudged) in [
        (
            format!("{before}[motor]{after}"),
            &["the gyro", "the accelerometer"][..],
        ),
        (
            format!("{before}[imu]{gyro}\n[motor]{after}"),
            &["the accelerometer"],
        ),
    ] {
        let verdict = judged_with(&log, &map);
        assert_eq!(reasons(&verdict), [""; 0], "{unjudged:?}");
        assert_eq!(verdict.rejected, 0);
        let [speed, yaw_rate, sideslip] = [
            verdict.speed_rms_m_s,
            verdict.yaw_rate_rms_rad_s,
            verdict.sideslip_rms_rad,
        ]
        .map(Option::unwrap);
        assert!(speed < 0.03, "{speed}");
        assert!(yaw_rate < 0.08, "{yaw_rate}");
        assert!(sideslip < 0.025, "{sideslip}");
        let said = |what: &str| verdict.not_judged.iter().any(|one| one == what);
        assert_eq!(said("the gyro"), unjudged.contains(&"the gyro"));
        assert!(said("the accelerometer"));
        assert_eq!(verdict.gyro_scale.is_none(), said("the gyro"));
        assert_eq!(verdict.findings, [""; 0]);
    }
}

#[test]
fn the_watches_begin_when_every_sensor_has_been_heard() {
    // The board is silent for 0.93 s: its first record stays.
    let mut rows: Vec<String> = log(7, &|_, _| {}).lines().map(str::to_owned).collect();
    let cells = |row: &str| row.split(',').map(str::to_owned).collect::<Vec<_>>();
    let first = cells(&rows[1])[..10].join(",");
    for row in &mut rows[1..94] {
        *row = [first.as_str(), &cells(row)[10..].join(",")].join(",");
    }
    let verdict = judged_with(&rows.join("\n"), &dart_map());
    assert_eq!(reasons(&verdict), [""; 0]);
    assert_eq!(verdict.rejected, 0);
    let from = verdict.watched_from_s.unwrap();
    assert!((0.8..1.3).contains(&from), "{from}");
}

#[test]
fn how_far_a_path_bends_otherwise_than_steered_is_measured() {
    let log = log(7, &|_, _| {});
    let map = dart_map();
    let (before, _) = map.split_once("[steering]").unwrap();
    // The circle has a radius of 1.3 m; the wheels of this command would bend by 0.3 1/m more.
    let radians = (dart().vehicle.wheelbase_m() * (1.0 / 1.3 + 0.3)).atan() / 0.28;
    let map = format!("{before}[steering]\ncolumn = \"steering\"\nradians_per_unit = {radians}\n");
    let bends = judged_with(&log, &map).bends.unwrap();
    assert!(
        (0.25..0.4).contains(&bends.curvature_error_per_m),
        "{bends:?}"
    );
    // It is a gentle bend.
    assert_eq!(bends.curvature_error_per_m_per_m_s2, None);
    assert!((1.3..1.8).contains(&bends.lateral_m_s2), "{bends:?}");
}

#[test]
fn cameras_of_20_hz_are_judged() {
    let log = log(7, &|_, _| {});
    let rows = log.lines().enumerate();
    let slow: Vec<&str> = rows
        .filter(|(row, _)| row % 5 == 0)
        .map(|(_, row)| row)
        .collect();
    let map = dart_map().replace("exposures_hz = 100", "exposures_hz = 20");
    let verdict = judged_with(&slow.join("\n"), &map);
    let speed = verdict.speed_rms_m_s.unwrap();
    assert!(speed < 0.06, "{speed}");
}

#[test]
fn a_ghost_ends_the_drive_once_and_is_never_followed() {
    let verdict = judged(&|time, pose| {
        if (12.0..20.0).contains(&time) {
            // It lives: its noise is that of a body.
            let noise = pose[2].fract() * 1e-4;
            *pose = [-6.0 + noise, 4.0 - noise, 0.3 + noise];
        }
    });
    assert_eq!(reasons(&verdict), ["pose-implausible"]);
    assert!(
        (verdict.stops[0].t_s - 12.0).abs() < 0.3,
        "{:?}",
        verdict.stops
    );
    assert_eq!(verdict.adopted_ghosts, 0);
    assert_eq!(verdict.ghosts_s.len(), 1);
    let [from, to] = verdict.ghosts_s[0];
    assert!((from - 12.0).abs() < 0.05 && (to - 20.0).abs() < 0.05);
    // The car is found again within a second, without a word of the operator.
    assert!(verdict.asked_s.is_empty(), "{:?}", verdict.asked_s);
    assert!(verdict.rejected < 100, "{}", verdict.rejected);
}

#[test]
fn a_flip_for_a_frame_is_refused_and_listed() {
    let verdict = judged(&|time, pose| {
        if (18.0..18.009).contains(&time) {
            pose[2] += 2.0;
        }
    });
    assert_eq!(reasons(&verdict), [""; 0]);
    assert_eq!(verdict.flips_s.len(), 1, "{:?}", verdict.flips_s);
}

#[test]
fn a_record_without_frames_says_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let csv = folder.path().join("log.csv");
    fs::write(&csv, "t,x,y,yaw,v,s\n0,,,,0,0\n0.01,,,,0,0\n").unwrap();
    let map = folder.path().join("map.toml");
    let text = "[time]\ncolumn = \"t\"\nunit = \"s\"\nunix = false\n\
                [pose]\nempty_rows = \"no-sample\"\nx = \"x\"\ny = \"y\"\nyaw = \"yaw\"\n\
                [motor]\nspeed = \"v\"\n[steering]\ncolumn = \"s\"\nradians_per_unit = 0.5\n";
    fs::write(&map, text).unwrap();
    let record = folder.path().join("log.mcap");
    import(&[&csv], &map, &record, |_, _| {}).unwrap();
    let error = judge(&record, &dart(), WHOLE, |_, _| {}).unwrap_err();
    assert!(
        error.to_string().contains("no frames of the cameras"),
        "{error}"
    );
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn a_wrong_sign_or_scale_of_a_sensor_is_named_with_its_fix() {
        let log = log(7, &|_, _| {});
        for (right, scale, finding) in [
            (
                "left_acceleration = \"acc y (IMU)\"",
                -1.0,
                "accelerometer: its left axis points to the right: negate imu.left_acceleration",
            ),
            (
                "yaw_rate = \"W (IMU)\"",
                -1.0,
                "gyro: it reads the other sign than the cameras (-1.0",
            ),
            ("speed = \"vel encoder\"", 0.8, "motor: reads 0.8"),
        ] {
            let map = dart_map();
            let (key, column) = right.split_once(" = ").unwrap();
            let wrong = format!("{key} = {{ column = {column}, scale = {scale} }}");
            assert!(map.contains(right), "{right}");
            let found = judged_with(&log, &map.replace(right, &wrong)).findings;
            let is_named = found.iter().any(|one| one.starts_with(finding));
            assert!(is_named, "{finding}: {found:?}");
        }
    }

    #[test]
    fn slower_cameras_give_fewer_poses_and_are_judged_against_all() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        fs::write(file("log.csv"), log(7, &|_, _| {})).unwrap();
        fs::write(file("map.toml"), dart_map()).unwrap();
        let record = file("log.mcap");
        import(&[file("log.csv")], &file("map.toml"), &record, |_, _| {}).unwrap();
        let judged = |cameras_hz| {
            let part = Part {
                cameras_hz,
                ..WHOLE
            };
            judge(&record, &dart(), part, |_, _| {}).unwrap().0
        };
        let all = judged(None);
        let slow = judged(Some(33.0));
        let share = slow.poses as f64 / all.poses as f64;
        assert!((share - 0.33).abs() < 0.01, "{share}");
        assert_eq!(reasons(&slow), [""; 0]);
        // The truth is the same.
        let truth = |verdict: &Verdict| verdict.true_sideslip_rms_rad.unwrap();
        assert!((truth(&slow) - truth(&all)).abs() < 1e-3);
        assert!(slow.speed_rms_m_s.unwrap() < 0.06);
    }

    #[test]
    fn a_jump_of_the_cameras_ends_no_drive_and_one_of_three_frames_does_not_move_the_speed() {
        for millimetres in [20.0, 30.0, 48.0, 80.0] {
            for frames in [1.0, 3.0, 8.0] {
                let verdict = judged(&move |time, pose| {
                    if (15.0..15.0 + 0.01 * frames - 1e-6).contains(&time) {
                        pose[0] += 1e-3 * millimetres;
                    }
                });
                let case = format!("{millimetres} mm, {frames} frames: {verdict:?}");
                assert_eq!(reasons(&verdict), [""; 0], "{case}");
                assert!(verdict.speed_rms_m_s.unwrap() < 0.06, "{case}");
                // Of 1.2 m/s. Eight frames that agree begin to be believed.
                let most = if frames < 4.0 { 1.3 } else { 1.9 };
                assert!(verdict.speed_max_m_s < most, "{case}");
                assert!(verdict.sideslip_rms_rad.unwrap() < 0.03, "{case}");
            }
        }
    }
}
