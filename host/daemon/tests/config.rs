//! The configuration: what is accepted, and how what is not is told.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use singletrack_control::{
    EstimatorConfig, Limits, Reference, SupervisorConfig, TrackingLoop, VehicleParameters,
};
use singletrackd::config::{BoardSection, Config, ConfigError, OuterLoopSection};

const EXAMPLE: &str = include_str!("../singletrackd.example.toml");

fn example() -> Config {
    Config::from_toml(EXAMPLE).unwrap()
}

/// The example with its commented-out defaults switched on.
fn spelt_out() -> String {
    EXAMPLE
        .lines()
        .map(|line| match line.strip_prefix('#') {
            Some(rest) if rest.starts_with(|c: char| c.is_ascii_lowercase() || c == '[') => rest,
            _ => line,
        })
        .map(|line| format!("{line}\n"))
        .collect()
}

/// The message about the spelt-out example with one line replaced.
fn refusal(section: &str, line: &str) -> String {
    let key = line.split_once('=').unwrap().0.trim();
    let mut here = String::new();
    let mut done = false;
    let mut text = String::new();
    for old in spelt_out().lines() {
        if let Some(header) = old.strip_prefix('[').and_then(|old| old.strip_suffix(']')) {
            header.clone_into(&mut here);
        }
        let is_it = here == section && old.split_once('=').is_some_and(|(k, _)| k.trim() == key);
        text += if is_it && !done { line } else { old };
        text.push('\n');
        done |= is_it;
    }
    assert!(done, "no {key} in [{section}]");
    match Config::from_toml(&text) {
        Ok(_) => panic!("[{section}] {line} was accepted"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn the_example_is_accepted_and_its_comments_tell_the_true_defaults() {
    let spelt_out = spelt_out();
    assert_ne!(spelt_out, EXAMPLE);
    assert_eq!(Config::from_toml(&spelt_out).unwrap(), example());
}

#[test]
fn the_example_documents_every_key() {
    let mut missing = Vec::new();
    let written: toml::Table = example().to_toml().unwrap().parse().unwrap();
    let documented: toml::Table = spelt_out().parse().unwrap();
    compare("", &written, &documented, &mut missing);
    assert_eq!(missing, Vec::<String>::new());

    fn compare(path: &str, all: &toml::Table, seen: &toml::Table, missing: &mut Vec<String>) {
        for (key, value) in all {
            let path = format!("{path}{key}");
            match (value, seen.get(key)) {
                (_, None) => missing.push(path),
                (toml::Value::Table(all), Some(toml::Value::Table(seen))) => {
                    compare(&format!("{path}."), all, seen, missing);
                }
                _ => {}
            }
        }
    }
}

#[test]
fn a_configuration_survives_being_written() {
    let config = example();
    assert_eq!(
        Config::from_toml(&config.to_toml().unwrap()).unwrap(),
        config
    );
}

#[test]
fn the_defaults_are_the_papers() {
    let config = example();
    let pilot = config.pilot().unwrap();
    assert_eq!(config.vehicle, VehicleParameters::paper());
    assert_eq!(pilot.limits, Limits::paper());
    assert_eq!(pilot.supervisor, SupervisorConfig::paper());
    assert_eq!(
        pilot.estimator,
        EstimatorConfig::for_vehicle(&VehicleParameters::paper())
    );
    assert!(matches!(pilot.reference, Reference::Circle(_)));
    assert!(matches!(pilot.tracking, TrackingLoop::Proportional(_)));
    assert_eq!(pilot.period, 0.01);
    assert_eq!(config.link(1).baud.get(), 115_200);
}

#[test]
fn the_examples_calibration_is_the_simulated_cars() {
    let simulated = singletrack_sim::default_board_configuration();
    assert_eq!(example().board, BoardSection::from(&simulated));
    assert_eq!(BoardSection::from(&simulated).configuration(), simulated);
}

#[test]
fn unknown_keys_are_refused_by_name() {
    for section in [
        "serial",
        "motion_capture",
        "motion_capture.pose",
        "motion_capture.timing",
        "law",
        "outer_loop",
        "reference",
        "vehicle",
        "limits",
        "estimator",
        "supervisor",
        "board",
        "board.servo",
        "board.esc",
        "board.speed",
        "control",
        "record",
        "socket",
    ] {
        let header = format!("\n[{section}]\n");
        let text = spelt_out().replacen(&header, &format!("{header}surplus_key = 1\n"), 1);
        assert_ne!(text, spelt_out(), "no section {section}");
        let message = Config::from_toml(&text).unwrap_err().to_string();
        assert!(message.contains("surplus_key"), "{section}: {message}");
    }
    let message = Config::from_toml(&format!("{EXAMPLE}\n[surplus]\n"))
        .unwrap_err()
        .to_string();
    assert!(message.contains("surplus"), "{message}");
}

#[test]
fn what_only_the_owner_knows_has_no_default() {
    for (section, key) in [
        ("serial", "port"),
        ("motion_capture", "server"),
        ("motion_capture", "rigid_body"),
        ("motion_capture", "up_axis"),
        ("law", "point_distance_m"),
        ("board.servo", "centre_us"),
        ("board.servo", "gain_us_per_rad"),
        ("board.esc", "neutral_us"),
        ("board.speed", "pulse_distance_um"),
    ] {
        let mut here = String::new();
        let text: String = EXAMPLE
            .lines()
            .filter(|line| {
                if let Some(header) = line.strip_prefix('[') {
                    here = header.trim_end_matches(']').to_owned();
                }
                !(here == section && line.starts_with(&format!("{key} =")))
            })
            .map(|line| format!("{line}\n"))
            .collect();
        let message = Config::from_toml(&text).unwrap_err().to_string();
        assert!(message.contains(key), "{section}.{key}: {message}");
    }
}

#[test]
fn every_mistake_is_told_by_key_value_and_fix() {
    for (section, line, parts) in [
        (
            "serial",
            "port = \"\"",
            &["serial.port", "empty", "/dev/ttyACM0"][..],
        ),
        ("serial", "baud = 300", &["serial.baud", "300", "9600"]),
        ("serial", "baud = \"fast\"", &["baud", "fast", "u32"]),
        (
            "motion_capture",
            "server = \"motive\"",
            &["server", "motive", "IP"],
        ),
        (
            "motion_capture",
            "server = \"0.0.0.0\"",
            &["motion_capture.server", "0.0.0.0", "computer"],
        ),
        (
            "motion_capture",
            "rigid_body = \"\"",
            &["motion_capture.rigid_body", "\"\"", "1 to 255"],
        ),
        (
            "motion_capture",
            "up_axis = \"x\"",
            &["up_axis", "`x`", "`y` or `z`"],
        ),
        (
            "motion_capture",
            "transport = \"tcp\"",
            &["transport", "`tcp`", "unicast"],
        ),
        (
            "motion_capture",
            "transport = \"multicast\"",
            &["motion_capture.interface", "0.0.0.0", "local address"],
        ),
        (
            "motion_capture",
            "command_port = 0",
            &["motion_capture.command_port", "0", "65535"],
        ),
        (
            "motion_capture",
            "data_port = 0",
            &["motion_capture.data_port", "0", "65535"],
        ),
        (
            "motion_capture",
            "marker_offset_m = [0.0, 7.0]",
            &["motion_capture.marker_offset_m", "7", "-1 and 1"],
        ),
        (
            "motion_capture",
            "marker_yaw_rad = 90.0",
            &["motion_capture.marker_yaw_rad", "90", "3.14"],
        ),
        (
            "motion_capture.pose",
            "max_tilt_rad = -0.5",
            &["motion_capture.pose.max_tilt_rad", "-0.5", "above 0"],
        ),
        (
            "motion_capture.pose",
            "max_speed_m_s = nan",
            &["motion_capture.pose.max_speed_m_s", "NaN", "above 0"],
        ),
        (
            "motion_capture.pose",
            "max_speed_m_s = 1.0",
            &["motion_capture.pose.max_speed_m_s", "1", "raise it"],
        ),
        (
            "motion_capture.pose",
            "max_consecutive_rejects = 0",
            &["max_consecutive_rejects", "0", "1 and 1000"],
        ),
        (
            "motion_capture.timing",
            "stale_after_ms = 5",
            &["motion_capture.timing.stale_after_ms", "5", "20 and 1000"],
        ),
        (
            "law",
            "kind = \"velocity-point\"",
            &["law.kind", "velocity-point", "front-point"],
        ),
        (
            "law",
            "point_distance_m = 0.0",
            &["point_distance_m", "0", "above zero"],
        ),
        (
            "law",
            "front_axle_distance_m = 0.3",
            &["front_axle_distance_m", "0.3", "0.26"],
        ),
        (
            "outer_loop",
            "gain_per_s = [1.0, -1.0]",
            &["outer_loop.gain_per_s", "-1", "not negative"],
        ),
        (
            "outer_loop",
            "gain_per_s = [1.0]",
            &["gain_per_s", "length 1", "2"],
        ),
        (
            "reference",
            "radius_m = 0.0",
            &["[reference]", "0", "above zero"],
        ),
        (
            "reference",
            "kind = \"square\"",
            &["square", "figure-of-eight"],
        ),
        (
            "vehicle",
            "mass_kg = -1.9",
            &["mass_kg", "-1.9", "above zero"],
        ),
        (
            "limits",
            "max_speed_m_s = 0.0",
            &["limits.max_speed_m_s", "0", "above 0"],
        ),
        (
            "limits",
            "max_speed_m_s = 3.0",
            &["limits.max_speed_m_s", "3", "board.speed.max_forward_mm_s"],
        ),
        (
            "limits",
            "max_reverse_speed_m_s = 0.5",
            &["limits.max_reverse_speed_m_s", "0.5", "max_reverse_mm_s"],
        ),
        (
            "limits",
            "max_acceleration_m_s2 = inf",
            &["limits.max_acceleration_m_s2", "inf", "at most 50"],
        ),
        (
            "limits",
            "max_steering_rad = 0.6",
            &["limits.max_steering_rad", "0.6", "0.525 rad"],
        ),
        (
            "limits",
            "creep_speed_m_s = 2.0",
            &["limits.creep_speed_m_s", "2", "at most 1.5"],
        ),
        (
            "estimator",
            "marker_loss = \"guess\"",
            &["marker_loss", "guess", "`hold` or `coast`"],
        ),
        (
            "estimator",
            "position_noise_m = 0.0",
            &["estimator.position_noise_m", "0", "above 0"],
        ),
        (
            "estimator",
            "prediction_horizon_ms = 500.0",
            &["estimator.prediction_horizon_ms", "500", "0 and 100"],
        ),
        (
            "supervisor",
            "hold_ms = 0",
            &["supervisor.hold_ms", "0", "20 and 900"],
        ),
        (
            "supervisor",
            "hold_distance_m = 0.45",
            &["board.max_pose_age_ms", "950", "shorten the hold"],
        ),
        (
            "supervisor",
            "fresh_ms = 400",
            &["supervisor.fresh_ms", "400", "10 and 300"],
        ),
        ("supervisor", "hold_ms = -5", &["hold_ms", "-5", "u32"]),
        (
            "supervisor",
            "standing_speed_m_s = 1.0",
            &["supervisor.standing_speed_m_s", "1", "at most 0.2"],
        ),
        (
            "board",
            "failsafe = \"hope\"",
            &["failsafe", "hope", "`coast` or `brake`"],
        ),
        (
            "board",
            "max_pose_age_ms = 1200",
            &["board.max_pose_age_ms", "1200", "1000"],
        ),
        (
            "board.servo",
            "gain_us_per_rad = 10",
            &["board.", "servo.gain_us_per_rad", "10", "50 to 5000"],
        ),
        (
            "board.servo",
            "centre_us = 2000",
            &["board.servo.centre_us", "2000", "1080 to 1920"],
        ),
        (
            "board.esc",
            "neutral_us = 1700",
            &["board.esc.neutral_us", "1700", "1470 to 1530"],
        ),
        (
            "board.esc",
            "brake_us = 1600",
            &["board.esc.brake_us", "1600", "1200 to 1469"],
        ),
        (
            "board.speed",
            "pulse_distance_um = 0",
            &["board.speed.pulse_distance_um", "0", "1 to 65535"],
        ),
        (
            "control",
            "period_ms = 1",
            &["control.period_ms", "1", "5 and 50"],
        ),
        (
            "control",
            "realtime_priority = 99",
            &["control.realtime_priority", "99", "0 and 90"],
        ),
        (
            "control",
            "stop_deceleration_m_s2 = 1.0",
            &["board.max_pose_age_ms", "1750 ms", "brake harder"],
        ),
        (
            "record",
            "directory = \"\"",
            &["record.directory", "empty", "record.enabled = false"],
        ),
        (
            "socket",
            "path = \"\"",
            &["socket.path", "1 to 107 bytes", "socket.enabled = false"],
        ),
    ] {
        let message = refusal(section, line);
        for part in parts {
            assert!(
                message.contains(part),
                "[{section}] {line}: no {part:?} in {message:?}"
            );
        }
    }
}

#[test]
fn keys_of_another_kind_are_refused_and_missing_ones_named() {
    for (from, to, part) in [
        (
            "radius_m = 1.0",
            "",
            "reference.radius_m is missing: kind = \"circle\" needs it",
        ),
        (
            "radius_m = 1.0",
            "radius_m = 1.0\nfile = \"path.csv\"",
            "reference.file is no key of kind = \"circle\"",
        ),
        (
            "radius_m = 1.0",
            "radius_m = \"wide\"",
            "radius_m = \"wide\"",
        ),
        (
            "gain_per_s = [1.0, 1.0]",
            "",
            "outer_loop.gain_per_s is missing",
        ),
    ] {
        let text = EXAMPLE.replacen(&format!("\n{from}\n"), &format!("\n{to}\n"), 1);
        assert_ne!(text, EXAMPLE, "{from}");
        let message = Config::from_toml(&text).unwrap_err().to_string();
        assert!(message.contains(part), "{to}: {message}");
    }
}

#[test]
fn a_loop_that_is_opened_for_a_while_may_keep_its_gains() {
    let text = EXAMPLE.replacen("\nkind = \"proportional\"\n", "\nkind = \"open-loop\"\n", 1);
    assert_ne!(text, EXAMPLE);
    let config = Config::from_toml(&text).unwrap();
    assert_eq!(config.outer_loop, OuterLoopSection::OpenLoop {});
}

#[test]
fn multicast_takes_no_bitstream_and_needs_a_group() {
    let multicast = "transport = \"multicast\"\ninterface = \"192.168.1.2\"\n";
    let with = |more: &str| {
        EXAMPLE.replacen(
            "\n[motion_capture]\n",
            &format!("\n[motion_capture]\n{multicast}{more}\n"),
            1,
        )
    };
    Config::from_toml(&with("")).unwrap();
    for (line, part) in [
        ("bitstream = \"4.1\"", "motion_capture.bitstream is 4.1"),
        ("bitstream = \"2.5\"", "2.5 is not supported"),
        ("bitstream = \"new\"", "write it as \"4.1\""),
        ("group = \"10.0.0.1\"", "motion_capture.group is 10.0.0.1"),
    ] {
        let message = Config::from_toml(&with(line)).unwrap_err().to_string();
        assert!(message.contains(part), "{line}: {message}");
    }
}

#[test]
fn waypoints_are_found_beside_the_file_and_their_mistakes_told_by_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("daemon.toml");
    let start = EXAMPLE.find("kind = \"circle\"").unwrap();
    let end = start + EXAMPLE[start..].find("\n#").unwrap();
    let text = format!(
        "{}kind = \"waypoints\"\nfile = \"path.csv\"{}",
        &EXAMPLE[..start],
        &EXAMPLE[end..]
    );
    std::fs::write(&file, text).unwrap();
    let waypoints = folder.path().join("path.csv");

    let message = Config::read(&file).unwrap_err().to_string();
    assert!(message.contains("path.csv"), "{message}");

    std::fs::write(&waypoints, "t_s,x_m,y_m\n0,0,0\n2,1,half\n").unwrap();
    let message = Config::read(&file).unwrap_err().to_string();
    assert!(message.contains("line: 3"), "{message}");

    std::fs::write(&waypoints, "t_s,x_m,y_m\n0,0,0\n2,1,0\n").unwrap();
    let config = Config::read(&file).unwrap();
    assert!(matches!(
        config.pilot().unwrap().reference,
        Reference::Waypoints(_)
    ));
}

#[test]
fn a_missing_file_is_named() {
    let error = Config::read("/nowhere/daemon.toml".as_ref()).unwrap_err();
    assert!(matches!(error, ConfigError::Read { .. }));
    assert!(error.to_string().contains("/nowhere/daemon.toml"));
}

#[test]
fn a_file_that_is_wrong_is_named_whatever_is_wrong_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("daemon.toml");
    for (text, part) in [
        ("colour = 1\n".to_owned(), "colour"),
        (
            EXAMPLE.replace("max_forward_mm_s = 1500", "max_forward_mm_s = 1"),
            "limits.max_speed_m_s",
        ),
    ] {
        std::fs::write(&file, text).unwrap();
        let message = Config::read(&file).unwrap_err().to_string();
        assert!(message.contains("daemon.toml: "), "{message}");
        assert!(message.contains(part), "{message}");
        assert_eq!(message, message.trim_end());
    }
}
