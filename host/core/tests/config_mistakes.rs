//! What is refused as a configuration: every message names key, value and fix.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::{fs, path::Path};

use singletrack_core::config::Config;

const EXAMPLE: &str = include_str!("../../daemon/singletrackd.example.toml");

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

fn key_of(line: &str) -> &str {
    line.split('=').next().unwrap().trim()
}

/// The spelt-out example with `line` in `section`: in the place of the line with
/// the same key, if there is one; without that line, if `line` is a key alone.
fn with(section: &str, line: &str) -> String {
    let mut here = String::new();
    let mut text = String::new();
    let mut seen = false;
    for old in spelt_out().lines() {
        if here == section && key_of(old) == key_of(line) && old.contains('=') {
            continue;
        }
        text += old;
        text += "\n";
        if let Some(header) = old.strip_prefix('[').and_then(|old| old.strip_suffix(']')) {
            header.clone_into(&mut here);
            if here == section {
                seen = true;
                if line.contains('=') {
                    text += line;
                    text += "\n";
                }
            }
        }
    }
    assert!(seen, "no section {section}");
    text
}

fn refusal(text: &str) -> String {
    match Config::from_toml(text) {
        Ok(_) => panic!("accepted:\n{text}"),
        Err(error) => error.to_string(),
    }
}

// One mistake a line: section | line in it | key, value and fix that the message
// must name.

const WRONG_TYPES: &str = r#"
serial | port = 5 | serial.port | 5 | quotation marks
serial | baud = "fast" | serial.baud | "fast" | a whole number
motion_capture | server = "motive" | motion_capture.server | "motive" | IP
motion_capture | server = 192 | motion_capture.server | 192 | quotation marks
motion_capture | up_axis = "x" | motion_capture.up_axis | "x" | "y" or "z"
motion_capture | up_axis = "up" | motion_capture.up_axis | "up" | "y" or "z"
motion_capture | up_axis = z | motion_capture.up_axis | z | quotation marks
motion_capture | transport = "serial" | motion_capture.transport | "serial" | "unicast", "multicast" or "tcp"
motion_capture | kind = "vicon" | motion_capture.kind | "vicon" | "natnet", "vrpn" or "qualisys"
motion_capture | bitstream = "new" | motion_capture.bitstream | "new" | write it as "4.1"
motion_capture | bitstream = "2.5" | motion_capture.bitstream | "2.5" | 2.7 to 4.4
motion_capture | bitstream = 4.1 | motion_capture.bitstream | 4.1 | quotation marks
motion_capture | command_port = 70000 | motion_capture.command_port | 70000 | 0 to 65535
motion_capture | marker_offset_m = 0.1 | motion_capture.marker_offset_m | 0.1 | two numbers
outer_loop | gain_per_s = [1.0] | outer_loop.gain_per_s | [1.0] | two numbers
outer_loop | feed_forward = 1 | outer_loop.feed_forward | 1 | true or false
outer_loop | kind = "lqr" | outer_loop.kind | "lqr" | "proportional", "lqi", "mpc", "open-loop" or "own"
reference | kind = "square" | reference.kind | "square" | figure-of-eight
reference | kind = "circel" | reference.kind | "circel" | did you mean "circle"?
reference | radius_m = "wide" | reference.radius_m | "wide" | a number
law | kind = "frontpoint" | law.kind | "frontpoint" | did you mean "front-point"?
estimator | marker_loss = "guess" | estimator.marker_loss | "guess" | "hold" or "dead-reckon"
supervisor | hold_ms = -5 | supervisor.hold_ms | -5 | not negative
supervisor | hold_ms = 0.3 | supervisor.hold_ms | 0.3 | a whole number
supervisor | hold_ms = 300 ms | supervisor.hold_ms | 300 ms | the example
supervisor | require_real_time = "yes" | supervisor.require_real_time | "yes" | true or false
board | failsafe = "hope" | board.failsafe | "hope" | "coast" or "brake"
board.servo | gain_us_per_rad = -40000 | board.servo.gain_us_per_rad | -40000 | -32768 to 32767
control | realtime_priority = 300 | control.realtime_priority | 300 | 0 to 255
fence | corners_m = [1.0, 2.0] | fence.corners_m | 1.0 | two numbers
socket | enabled = "no" | socket.enabled | "no" | true or false
"#;

const OUT_OF_RANGE: &str = r#"
serial | port = "" | serial.port | empty | /dev/ttyACM0
serial | baud = 300 | serial.baud | 300 | between 9600 and 2000000
motion_capture | server = "0.0.0.0" | motion_capture.server | 0.0.0.0 | address of the computer
motion_capture | server = "239.255.42.99" | motion_capture.server | 239.255.42.99 | address of the computer
motion_capture | transport = "tcp" | motion_capture.transport | "tcp" | "unicast" or "multicast"
motion_capture | sensor = 1 | motion_capture.sensor | 1 | only kind = "vrpn" has sensors
motion_capture | rigid_body = "" | motion_capture.rigid_body | "" | 1 to 255
motion_capture | command_port = 0 | motion_capture.command_port | 0 | between 1 and 65535
motion_capture | data_port = 0 | motion_capture.data_port | 0 | between 1 and 65535
motion_capture | marker_offset_m = [0.0, 7.0] | motion_capture.marker_offset_m | 7 | between -1 and 1
motion_capture | marker_yaw_rad = 90.0 | motion_capture.marker_yaw_rad | 90 | 3.14
motion_capture.pose | max_tilt_rad = -0.5 | motion_capture.pose.max_tilt_rad | -0.5 | above 0
motion_capture.pose | max_speed_m_s = nan | motion_capture.pose.max_speed_m_s | NaN | above 0
motion_capture.pose | max_consecutive_rejects = 0 | motion_capture.pose.max_consecutive_rejects | 0 | between 1 and 1000
motion_capture.timing | stale_after_ms = 5 | motion_capture.timing.stale_after_ms | 5 | between 20 and 1000
law | point_distance_m = 0.0 | law.point_distance_m | 0 | above zero
law | point_distance_m = inf | law.point_distance_m | inf | finite
outer_loop | gain_per_s = [1.0, -1.0] | outer_loop.gain_per_s | -1 | not negative
outer_loop | gain_per_s = [nan, 1.0] | outer_loop.gain_per_s | NaN | finite
supervisor | imu_silence_ms = 300 | supervisor.imu_silence_ms | 300 | between 20 and 200
fence | braking_m_s2 = 0.0 | fence.braking_m_s2 | 0 | above 0
board.esc | max_us = 1530 | board.esc.max_us | 1530 | would never drive
control | period_ms = 50 | watch.max_gap_ms | 80 | give it two periods, 100 ms
reference | radius_m = 0.0 | reference.radius_m | 0 | above zero
reference | radius_m = 1e300 | reference.radius_m | 1000000 | between -1000 and 1000
reference | angular_velocity_rad_s = nan | reference.angular_velocity_rad_s | NaN | between -100 and 100
vehicle | front_axle_distance_m = 136.8 | vehicle.front_axle_distance_m | 136.8 | at most 2; the axles are in m
vehicle | rear_axle_distance_m = -0.1 | vehicle.rear_axle_distance_m | -0.1 | above 0
vehicle | mass_kg = -1.9 | vehicle.mass_kg | -1.9 | above zero
limits | max_speed_m_s = 0.0 | limits.max_speed_m_s | 0 | above 0
limits | max_acceleration_m_s2 = inf | limits.max_acceleration_m_s2 | inf | at most 50
limits | creep_speed_m_s = 2.0 | limits.creep_speed_m_s | 2 | at most 1.5
estimator | position_noise_m = 0.0 | estimator.position_noise_m | 0 | above 0
estimator | prediction_horizon_ms = 500.0 | estimator.prediction_horizon_ms | 500 | between 0 and 100
supervisor | hold_ms = 0 | supervisor.hold_ms | 0 | between 20 and 900
supervisor | standing_speed_m_s = 1.0 | supervisor.standing_speed_m_s | 1 | at most 0.2
supervisor | max_damaged_frames = 0.0 | supervisor.max_damaged_frames | 0 | above 0
watch | max_gap_ms = 500 | watch.max_gap_ms | 500 | between 20 and 95
watch | speed_ratio = -1.0 | watch.speed_ratio | -1 | above 0
fence | corners_m = [[0.0, 0.0], [1.0, 0.0]] | fence.corners_m | 2 corners | give 3 to 16
fence | corners_m = [[0.0, 0.0], [1.0, 0.0], [nan, 1.0]] | fence.corners_m | NaN | between -1000 and 1000
safety_filter | reaction_ms = 10.0 | safety_filter.reaction_ms | 10 | between 50 and 2000
safety_filter | position_error_m = nan | safety_filter.position_error_m | NaN | between 0 and 0.5
safety_filter | course_error_rad = -0.1 | safety_filter.course_error_rad | -0.1 | between 0 and 0.5
safety_filter | curvature_error_per_m = 9.0 | safety_filter.curvature_error_per_m | 9 | between 0 and 5
safety_filter | speed_error_m_s = inf | safety_filter.speed_error_m_s | inf | between 0 and 1
fence | margin_m = -0.1 | fence.margin_m | -0.1 | between 0 and 10
board | max_pose_age_ms = 1200 | board.max_pose_age_ms | 1200 | 1 to 1000
board.servo | gain_us_per_rad = 10 | board.servo.gain_us_per_rad | 10 | 50 to 5000
actuators | steering_table = [[1080, 0.5]] | actuators.steering_table | [[1080.0, 0.5]] | 2 to 32
actuators | steering_table = [[1080, 0.5], [1500, nan], [1920, -0.5]] | actuators.steering_table |  | not a pulse
actuators | steering_table = [[1080, 0.5], [1920, 0.1], [1500, 0.0]] | actuators.steering_table |  | 1500 us after 1920 us
actuators | steering_table = [[1080, 0.5], [1500, -0.1], [1920, 0.0]] | actuators.steering_table |  | turn back at 1500 us
actuators | steering_table = [[1000, 0.5], [1500, 0.0], [1920, -0.5]] | actuators.steering_table |  | board.servo.min_us to max_us
actuators | steering_table = [[1080, -0.5], [1500, 0.0], [1920, 0.5]] | actuators.steering_table |  | the other sign
actuators | steering_table = [[1080, 0.5], [1520, 0.0], [1920, -0.5]] | actuators.steering_table |  | set it to 1520
actuators | steering_table = [[1080, 0.5], [1500, 0.0], [1920, -0.4]] | limits.max_steering_rad | 0.45 | 0.400 rad
board.servo | centre_us = 2000 | board.servo.centre_us | 2000 | 1080 to 1920
board.esc | neutral_us = 1700 | board.esc.neutral_us | 1700 | 1470 to 1530
board.speed | pulse_distance_um = 0 | board.speed.pulse_distance_um | 0 | 100 to 30000
board.speed | pulse_distance_um = 65000 | board.speed.pulse_distance_um | 65000 | one that stands or whose sensor is dead
control | period_ms = 1 | control.period_ms | 1 | between 5 and 50
control | realtime_priority = 99 | control.realtime_priority | 99 | between 0 and 90
record | directory = "" | record.directory | empty | record.enabled = false
socket | path = "" | socket.path |  | 1 to 107 bytes
"#;

const CONTRADICTIONS: &str = r#"
motion_capture | transport = "multicast" | motion_capture.interface | 0.0.0.0 | the local address
motion_capture.pose | max_speed_m_s = 1.0 | motion_capture.pose.max_speed_m_s | 1 | raise it
law | kind = "velocity-point" | law.kind | velocity-point | "front-point" only
law | front_axle_distance_m = 0.3 | law.front_axle_distance_m | 0.3 | 0.26
limits | max_speed_m_s = 3.0 | limits.max_speed_m_s | 3 | board.speed.max_forward_mm_s
board.speed | pulse_distance_um = 100 | board.speed.max_forward_mm_s | 1500 | 1 to 1200: the board measures no more than 12 pulses
limits | max_reverse_speed_m_s = 0.5 | limits.max_reverse_speed_m_s | 0.5 | board.speed.max_reverse_mm_s
limits | max_steering_rad = 0.6 | limits.max_steering_rad | 0.6 | 0.525 rad
limits | max_lateral_acceleration_m_s2 = 5.0 | limits.max_lateral_acceleration_m_s2 | 5 | vehicle.friction
supervisor | fresh_ms = 400 | supervisor.fresh_ms | 400 | between 10 and 300
supervisor | blind_ms = 100 | supervisor.blind_ms | 100 | between 300 and 950
supervisor | blind_distance_m = 0.1 | supervisor.blind_distance_m | 0.1 | between 0.15 and 2
supervisor | arm_battery_v = 3.0 | supervisor.arm_battery_v | 3 | between 6.4 and 60
fence | corners_m = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]] | fence.corners_m | corner 0 | in order
board.servo | min_us = 2000 | board.servo.max_us | 1920 | 2000 to 2200
board.esc | brake_us = 1600 | board.esc.brake_us | 1600 | 1200 to 1469
board | max_pose_age_ms = 300 | board.max_pose_age_ms | 300 | shorten the hold
control | stop_deceleration_m_s2 = 1.0 | board.max_pose_age_ms | 950 | brake harder
"#;

const WRONG_KEYS: &str = r#"
serial | bauds = 9600 | serial.bauds |  | did you mean baud?
serial | speed = 9600 | serial.speed |  | remove it
motion_capture | upaxis = "z" | motion_capture.upaxis |  | did you mean up_axis?
motion_capture.pose | max_tilt_deg = 5 | motion_capture.pose.max_tilt_deg |  | did you mean max_tilt_rad?
motion_capture.timing | stale_after_s = 1 | motion_capture.timing.stale_after_s |  | did you mean stale_after_ms?
law | point_distance_mm = 350 | law.point_distance_mm |  | did you mean point_distance_m?
outer_loop | gain = 1 | outer_loop.gain |  | did you mean gain_per_s?
reference | radius_cm = 100 | reference.radius_cm |  | did you mean radius_m?
vehicle | mass_g = 1900 | vehicle.mass_g |  | did you mean mass_kg?
limits | max_speed_kmh = 5 | limits.max_speed_kmh |  | did you mean max_speed_m_s?
limits | max_steering_deg = 25 | limits.max_steering_deg |  | did you mean max_steering_rad?
estimator | position_noise_mm = 1 | estimator.position_noise_mm |  | did you mean position_noise_m?
supervisor | hold_s = 0.3 | supervisor.hold_s |  | did you mean hold_ms?
watch | max_gap_s = 1 | watch.max_gap_s |  | did you mean max_gap_ms?
fence | corners = [] | fence.corners |  | did you mean corners_m?
board | max_pose_age_s = 1 | board.max_pose_age_s |  | did you mean max_pose_age_ms?
board.servo | center_us = 1500 | board.servo.center_us |  | did you mean centre_us?
board.esc | neutral = 1500 | board.esc.neutral |  | did you mean neutral_us?
board.speed | max_forward_m_s = 1 | board.speed.max_forward_m_s |  | did you mean max_forward_mm_s?
control | period_us = 10000 | control.period_us |  | did you mean period_ms?
record | folder = "x" | record.folder |  | remove it
socket | paths = "x" | socket.paths |  | did you mean path?
live | prt = 8765 | live.prt |  | did you mean port?
reference | waypoint = [] | reference.waypoint |  | did you mean waypoints?
"#;

const MISSING_KEYS: &str = r#"
serial | port | serial.port |  | is missing
motion_capture | server | motion_capture.server |  | is missing
motion_capture | rigid_body | motion_capture.rigid_body |  | is missing
motion_capture | up_axis | motion_capture.up_axis |  | is missing
law | kind | law.kind |  | is missing
law | point_distance_m | law.point_distance_m |  | is missing
outer_loop | gain_per_s | outer_loop.gain_per_s | proportional | needs it
reference | kind | reference.kind |  | is missing
reference | radius_m | reference.radius_m | circle | needs it
vehicle | front_axle_distance_m | vehicle.front_axle_distance_m |  | is missing
vehicle | rear_axle_distance_m | vehicle.rear_axle_distance_m |  | is missing
fence | braking_m_s2 | fence.braking_m_s2 |  | is missing
board.servo | centre_us | board.servo.centre_us |  | is missing
board.servo | gain_us_per_rad | board.servo.gain_us_per_rad |  | is missing
board.esc | neutral_us | board.esc.neutral_us |  | is missing
board.speed | pulse_distance_um | board.speed.pulse_distance_um |  | is missing
"#;

const KINDS: &str = r#"
reference | file = "path.csv" | reference.file | circle | remove it, or choose another kind
reference | half_length_m = 1.0 | reference.half_length_m | circle | remove it
reference | setpoint_timeout_ms = 100 | reference.setpoint_timeout_ms | circle | remove it
reference | kind = "waypoints" | reference.file | waypoints | needs it
reference | kind = "external" | reference.radius_m | external | remove it
reference | kind = "path" | reference.speed_m_s | path | needs it
reference | closed = true | reference.closed | circle | remove it
reference | start = "middle" | reference.start | middle | nearest
"#;

#[test]
fn every_mistake_in_a_line_is_reported_with_key_value_and_fix() {
    let mistakes = [
        WRONG_TYPES,
        OUT_OF_RANGE,
        CONTRADICTIONS,
        WRONG_KEYS,
        MISSING_KEYS,
        KINDS,
    ]
    .concat();
    let mut count = 0;
    for mistake in mistakes.lines().filter(|line| !line.is_empty()) {
        let fields: Vec<_> = mistake.split(" | ").collect();
        let [section, line, parts @ ..] = fields.as_slice() else {
            panic!("no mistake: {mistake}");
        };
        assert_eq!(parts.len(), 3, "{mistake}");
        let message = refusal(&with(section, line));
        for part in parts {
            assert!(
                message.contains(part),
                "[{section}] {line}: no {part:?} in {message:?}"
            );
        }
        assert!(!message.contains('\n'), "{message}");
        count += 1;
    }
    assert!(count >= 120, "{count}");
}

#[test]
fn every_mistake_in_a_text_is_reported_with_key_value_and_fix() {
    let example = spelt_out();
    let twice = example.replace("\nhold_ms = 300\n", "\nhold_ms = 300\nhold_ms = 400\n");
    let steps = |steps: &str| {
        let start = example.find("kind = \"circle\"").unwrap();
        let end = start + example[start..].find("\n#").unwrap();
        let before = example[..start].replace("kind = \"proportional\"", "kind = \"open-loop\"");
        format!(
            "{before}kind = \"velocity-steps\"\nsteps = {steps}{}",
            &example[end..]
        )
    };
    for (text, parts) in [
        (String::new(), ["line 1", "serial", "add it"]),
        ("serial = 5\n".to_owned(), ["serial", "5", "write [serial]"]),
        (
            "[serial\n".to_owned(),
            ["line 1", "[serial", "expected `]`"],
        ),
        ("port: x\n".to_owned(), ["line 1", "port", "key = value"]),
        (twice, ["supervisor.hold_ms", "duplicate", "keep one"]),
        (
            format!("{example}\n[surplus]\n"),
            ["surplus", "unknown", "remove it"],
        ),
        (
            example.replace("\n[limits]\n", "\n[limit]\n"),
            ["limit", "unknown", "did you mean limits?"],
        ),
        (
            example.replace("\n[board.servo]\n", "\n[board.servos]\n"),
            ["board.servos", "unknown", "did you mean servo?"],
        ),
        (
            example.replace("\n[serial]\n", "\n[serial]\n[serial]\n"),
            ["serial", "duplicate", "keep one"],
        ),
        (steps("[]"), ["reference.steps", "0 given", "1 needed"]),
        (
            steps("[{ duration_s = 0.0, v_x_m_s = 0.6, v_y_m_s = 0.0 }]"),
            ["reference.duration_s", "0", "above zero"],
        ),
        (
            steps("[{ duration_s = 1.0, v_x_m_s = inf, v_y_m_s = 0.0 }]"),
            ["reference.v_x_m_s", "inf", "finite"],
        ),
        (
            steps("[{ duration_s = 1.0, v_x_m_s = 1.0 }]"),
            ["reference", "v_y_m_s", "is missing"],
        ),
        (
            steps("[{ duration_s = 1.0, v_x_m_s = 1.0, v_y_m_s = 1.0, v_z_m_s = 1.0 }]"),
            ["reference.v_z_m_s", "unknown", "did you mean"],
        ),
        (
            steps("[{ duration_s = 1.0, v_x_m_s = 1.0, v_y_m_s = 1.0 }]")
                .replace("kind = \"open-loop\"", "kind = \"proportional\""),
            ["outer_loop.kind", "proportional", "use \"open-loop\""],
        ),
    ] {
        let message = refusal(&text);
        for part in parts {
            assert!(message.contains(part), "no {part:?} in {message:?}");
        }
        assert!(!message.contains('\n'), "{message}");
    }
}

#[test]
fn every_section_refuses_a_key_that_it_has_not() {
    let text = spelt_out();
    let headers = text.lines().filter(|line| line.starts_with('['));
    let mut count = 0;
    for header in headers {
        let section = header.trim_matches(['[', ']']);
        let message = refusal(&with(section, "surplus_key = 1"));
        let key = format!("{section}.surplus_key");
        assert!(message.contains(&key), "{message}");
        assert!(message.contains("remove it"), "{message}");
        count += 1;
    }
    assert!(count >= 18, "{count}");
}

#[test]
fn a_kind_of_server_takes_its_own_keys_only() {
    for (lines, message) in [
        ("kind = \"vrpn\"\nsensor = 2", ""),
        ("kind = \"qualisys\"\ntransport = \"tcp\"", ""),
        (
            "kind = \"vrpn\"\nbitstream = \"4.1\"",
            "motion_capture.bitstream is 4.1: only NatNet has it",
        ),
        (
            "kind = \"qualisys\"\ntransport = \"multicast\"",
            "motion_capture.transport is \"multicast\": only NatNet has it",
        ),
        (
            "kind = \"vrpn\"\nrigid_body = \"car@192.168.1.10:3883\"",
            "write the tracker's name alone, of at most 99 bytes: \"car\" for",
        ),
    ] {
        let example = match lines.contains("rigid_body") {
            true => EXAMPLE.replacen("\nrigid_body = \"car\"\n", "\n", 1),
            false => EXAMPLE.to_owned(),
        };
        let section = format!("\n[motion_capture]\n{lines}\n");
        let text = example.replacen("\n[motion_capture]\n", &section, 1);
        match message {
            "" => drop(Config::from_toml(&text).unwrap()),
            message => assert!(refusal(&text).contains(message), "{}", refusal(&text)),
        }
    }
}

#[test]
fn multicast_takes_a_group_and_no_bitstream() {
    let with = |more: &str| {
        let multicast = "transport = \"multicast\"\ninterface = \"192.168.1.2\"";
        EXAMPLE.replacen(
            "\n[motion_capture]\n",
            &format!("\n[motion_capture]\n{multicast}\n{more}\n"),
            1,
        )
    };
    Config::from_toml(&with("")).unwrap();
    for (line, message) in [
        (
            "bitstream = \"4.1\"",
            "motion_capture.bitstream is 4.1: a server only changes it for unicast; leave it out",
        ),
        (
            "group = \"10.0.0.1\"",
            "motion_capture.group is 10.0.0.1: it must be a multicast address, 224.0.0.0",
        ),
    ] {
        let told = refusal(&with(line));
        assert!(told.contains(message), "{line}: {told}");
    }
}

/// The message about a configuration whose waypoints are in `path.csv`.
fn waypoint_refusal(folder: &Path) -> String {
    reference_refusal(folder, "kind = \"waypoints\"\nfile = \"path.csv\"")
}

/// The message about a configuration with these lines in `[reference]`.
fn reference_refusal(folder: &Path, reference: &str) -> String {
    let start = EXAMPLE.find("kind = \"circle\"").unwrap();
    let end = start + EXAMPLE[start..].find("\n#").unwrap();
    let text = format!("{}{reference}{}", &EXAMPLE[..start], &EXAMPLE[end..]);
    let file = folder.join("daemon.toml");
    fs::write(&file, text).unwrap();
    Config::read(&file).map_or_else(|error| error.to_string(), |_| String::new())
}

#[test]
fn every_mistake_in_a_waypoint_file_is_reported_with_line_value_and_fix() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("path.csv");
    let missing = waypoint_refusal(folder.path());
    assert!(missing.contains("path.csv: No such file"), "{missing}");
    fs::create_dir(&path).unwrap();
    let directory = waypoint_refusal(folder.path());
    assert!(directory.contains("path.csv: it is a folder; name a file"));
    fs::remove_dir(&path).unwrap();

    let header = "t_s,x_m,y_m\n";
    for (text, parts) in [
        ("", ["line 1", "", "must name the columns t_s,x_m,y_m"]),
        (
            "0,0,0\n1,1,1\n",
            ["line 1", "", "must name the columns t_s,x_m,y_m"],
        ),
        (
            "t,x,y\n0,0,0\n",
            ["line 1", "", "must name the columns t_s,x_m,y_m"],
        ),
        (
            "t_ms,x_m,y_m\n0,0,0\n",
            [
                "line 1",
                "and no others",
                "must name the columns t_s,x_m,y_m",
            ],
        ),
        (
            "t_s,x_m,y_m,z_m\n0,0,0,0\n",
            ["line 1", "and no others", "must name the columns"],
        ),
        (
            "t_s,x_m,y_m\n",
            [
                "waypoints",
                "0 given, at least 2 needed",
                "one waypoint a line",
            ],
        ),
        (
            "t_s,x_m,y_m\n0,0,0\n",
            [
                "waypoints",
                "1 given, at least 2 needed",
                "one waypoint a line",
            ],
        ),
        (
            "t_s,x_m,y_m\n0,0,0\n2,1,half\n",
            ["line 3", "y_m is no finite number", "write one"],
        ),
        (
            "t_s,x_m,y_m\n0,0,0\n2,NaN,0\n",
            ["line 3", "x_m is no finite number", "write one"],
        ),
        (
            "t_s,x_m,y_m\n0,0,0\ninf,1,0\n",
            ["line 3", "t_s is no finite number", "write one"],
        ),
        (
            "t_s,x_m,y_m\n0,0,0\n,1,0\n",
            ["line 3", "t_s is no finite number", "write one"],
        ),
        (
            "t_s,x_m,y_m\n0,0,0\n1,1\n",
            ["line: 3", "2 fields", "one number for each column"],
        ),
        (
            "t_s,x_m,y_m\n0,0,0\n2,1,0\n1,2,0\n",
            ["line 4", "t_s is 1, not after 2", "in order of time"],
        ),
        (
            "t_s,x_m,y_m\n0,0,0\n0,1,0\n",
            ["line 3", "t_s is 0, not after 0", "in order of time"],
        ),
    ] {
        fs::write(&path, text).unwrap();
        let message = waypoint_refusal(folder.path());
        for part in ["reference.file", "path.csv"].iter().chain(&parts) {
            assert!(
                message.contains(part),
                "{text:?}: no {part:?} in {message:?}"
            );
        }
    }
    fs::write(&path, format!("{header}0,0,0\n2,1,0\n")).unwrap();
    assert_eq!(waypoint_refusal(folder.path()), "");
    // The columns may come in any order.
    fs::write(&path, "y_m,t_s,x_m\n0,0,0\n1,2,0\n").unwrap();
    assert_eq!(waypoint_refusal(folder.path()), "");
}

#[test]
fn a_path_is_refused_with_the_key_the_line_or_the_point() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("path.csv");
    let path = "kind = \"path\"\nfile = \"path.csv\"\n";
    let good = "x_m,y_m\n0,0\n1,0.2\n2,0\n";
    for (csv, keys, parts) in [
        (good, "speed_m_s = 0.5", vec![]),
        (
            "y_m,x_m\n0,0\n1,0.2\n0,1\n",
            "speed_m_s = 0.5\nclosed = true",
            vec![],
        ),
        (
            "t_s,x_m,y_m\n0,0,0\n",
            "speed_m_s = 0.5",
            vec!["path.csv", "columns x_m,y_m"],
        ),
        (
            "x_m,y_m\n0,0\n1,here\n",
            "speed_m_s = 0.5",
            vec!["line 3", "y_m is no finite number"],
        ),
        (
            "x_m,y_m\n0,0\n",
            "speed_m_s = 0.5",
            vec!["reference.points", "at least 2"],
        ),
        (
            "x_m,y_m\n0,0\n1,0\n1,0\n",
            "speed_m_s = 0.5",
            vec!["reference.point 2", "0.005 m"],
        ),
        (
            "x_m,y_m\n0,0\n1,0\n0,0.01\n",
            "speed_m_s = 0.5",
            vec!["turns with a radius of"],
        ),
        (
            good,
            "speed_m_s = 1.6",
            vec!["reference.speed_m_s is 1.6", "limits.max_speed_m_s"],
        ),
        (
            good,
            "speed_m_s = 0.5\nlateral_acceleration_m_s2 = 2.5",
            vec![
                "reference.lateral_acceleration_m_s2 is 2.5",
                "limits.max_lateral",
            ],
        ),
        (
            good,
            "speed_m_s = 0.5\nacceleration_m_s2 = 2.5",
            vec![
                "reference.acceleration_m_s2 is 2.5",
                "limits.max_acceleration",
            ],
        ),
        (good, "speed_m_s = 0.0", vec!["reference.speed_m_s"]),
    ] {
        fs::write(&file, csv).unwrap();
        let message = reference_refusal(folder.path(), &format!("{path}{keys}"));
        assert_eq!(
            message.is_empty(),
            parts.is_empty(),
            "{csv:?}, {keys}: {message}"
        );
        for part in parts {
            assert!(message.contains(part), "no {part:?} in {message:?}");
        }
    }
}

#[test]
fn every_path_that_is_not_a_text_file_is_reported_with_its_kind() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::write(path("latin1"), b"[serial]\nport = \"/dev/\xe4\"\n").unwrap();
    fs::write(path("long"), vec![b'#'; (1 << 20) + 1]).unwrap();
    rustix::fs::mkfifoat(rustix::fs::CWD, path("pipe"), 0o600.into()).unwrap();
    for (path, parts) in [
        (path("nowhere"), ["nowhere", "No such file", ""]),
        (
            folder.path().to_owned(),
            ["", "it is a folder", "name a file"],
        ),
        (path("pipe"), ["pipe", "it is a pipe", "name a file"]),
        ("/dev/zero".into(), ["/dev/zero", "a device", "name a file"]),
        (
            path("latin1"),
            ["latin1", "line 2 is not UTF-8", "save the file as UTF-8"],
        ),
        (path("long"), ["long", "1048577 bytes", "the right file?"]),
    ] {
        let error = Config::read(&path).unwrap_err();
        let message = error.to_string();
        assert!(message.starts_with("can't read "), "{message:?}");
        for part in parts {
            assert!(message.contains(part), "no {part:?} in {message:?}");
        }
    }
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
        fs::write(&file, text).unwrap();
        let message = Config::read(&file).unwrap_err().to_string();
        assert!(message.contains("daemon.toml: "), "{message}");
        assert!(message.contains(part), "{message}");
        assert_eq!(message, message.trim_end());
    }
}
