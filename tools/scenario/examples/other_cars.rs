//! Drives cars that are not as their configuration says, and prints what each came to: the
//! way until the drive ended and after it, the speeds, the least clearance of the geofence,
//! and the reason.
//!
//! ```sh
//! cargo run --release -p singletrack-scenario --example other_cars
//! cargo run --release -p singletrack-scenario --example other_cars -- --board uno neutral
//! ```
//!
//! A word selects the cars whose name contains it.

use std::{error::Error, path::Path};

use singletrack_scenario::simulate::{RunOptions, Scenario, Summary, simulate_with};

/// What all drives share.
const COMMON: &str = r#"
[law]
kind = "front-point"
point_distance_m = 0.35
front_axle_distance_m = 0.1368
[control]
period_ms = 10
[plant]
kind = "car"
board = "BOARD"
"#;

/// The paper's circle, on a floor of 6 m by 6 m.
const CIRCLE: &str = r#"
[outer_loop]
kind = "proportional"
gain_per_s = [1.0, 1.0]
feed_forward = true
[reference]
kind = "circle"
radius_m = 1.0
angular_velocity_rad_s = RATE
start = "beginning"
[start]
point_p_m = [1.5, -0.5]
yaw_deg = 135.0
[run]
duration_s = 30.0
[fence]
corners_m = [[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]]
"#;

/// Straight on along x, in a hall.
const STRAIGHT: &str = r#"
[outer_loop]
kind = "open-loop"
[reference]
kind = "velocity-steps"
steps = [{ duration_s = 60.0, v_x_m_s = SPEED, v_y_m_s = 0.0 }]
[start]
point_p_m = [0.5, 0.0]
yaw_deg = 0.0
[run]
duration_s = 14.0
"#;

/// A wall 5 m ahead.
const WALL: &str = "[fence]\ncorners_m = [[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]]\n";

/// The reference of a drive.
#[derive(Clone, Copy)]
enum Course {
    /// The circle at 0.4 m/s.
    Circle,
    /// A circle at 0.73 m/s.
    Fast,
    /// Straight on, with a speed in m/s.
    Straight(&'static str),
    /// Straight on towards a wall.
    Wall(&'static str),
}
use Course::{Circle, Fast, Straight, Wall};

/// Name, course, what differs.
const CARS: &[(&str, Course, &str)] = &[
    ("calibrated, circle", Circle, ""),
    ("calibrated, fast circle", Fast, ""),
    ("calibrated, wall at 0.5 m/s", Wall("0.5"), ""),
    ("calibrated, wall at 1.0 m/s", Wall("1.0"), ""),
    (
        "calibrated, unplugged",
        Straight("0.5"),
        "[operator]\nunplug_at_s = 8.0\n",
    ),
    (
        "calibrated, unplugged at 1.0 m/s",
        Straight("1.0"),
        "[operator]\nunplug_at_s = 5.0\n",
    ),
    (
        "own supply, unplugged at 1.0 m/s",
        Straight("1.0"),
        "[truth.board]\nown_supply = true\n[operator]\nunplug_at_s = 5.0\n",
    ),
    (
        "kill output, unplugged at 1.0 m/s",
        Straight("1.0"),
        "[board]\nkill_output = true\n[operator]\nunplug_at_s = 5.0\n",
    ),
    (
        "calibrated, emergency stop",
        Straight("0.5"),
        "[operator]\nemergency_stop_at_s = 8.0\n",
    ),
    (
        "calibrated, disarmed",
        Straight("0.5"),
        "[operator]\ndisarm_at_s = 8.0\n",
    ),
    (
        "calibrated, board reset",
        Straight("0.5"),
        "[operator]\nreset_board_at_s = 8.0\n",
    ),
    ("calibrated, unproved, circle", Circle, "[truth]\n"),
    (
        "calibrated, unproved, straight",
        Straight("0.5"),
        "[truth]\n",
    ),
    // Servo.
    (
        "servo inverted, circle",
        Circle,
        "[truth.servo]\ngain_us_per_rad = 800\n",
    ),
    (
        "servo inverted, fast circle",
        Fast,
        "[truth.servo]\ngain_us_per_rad = 800\n",
    ),
    (
        "servo inverted, straight",
        Wall("0.5"),
        "[truth.servo]\ngain_us_per_rad = 800\n",
    ),
    (
        "servo trim 3 deg",
        Fast,
        "[truth.servo]\ncentre_us = 1542\n",
    ),
    (
        "servo trim 8 deg",
        Fast,
        "[truth.servo]\ncentre_us = 1612\n",
    ),
    (
        "servo gain 30 % less",
        Fast,
        "[truth.servo]\ngain_us_per_rad = -1143\n",
    ),
    (
        "servo gain 30 % more",
        Fast,
        "[truth.servo]\ngain_us_per_rad = -615\n",
    ),
    (
        "servo slow, 1 rad/s",
        Fast,
        "[truth.servo]\nmax_rate_rad_s = 1.0\n",
    ),
    ("servo lag 200 ms", Fast, "[truth.servo]\nlag_ms = 200.0\n"),
    (
        "servo backlash 3 deg",
        Fast,
        "[truth.servo]\nbacklash_us = 42\n",
    ),
    (
        "servo stuck from 6 s",
        Circle,
        "[truth.servo]\nstuck_from_s = 6.0\n",
    ),
    // ESC. In the first cases 1560 with a band of 60 is believed to be neutral.
    (
        "neutral 1500, believed 1560, unarmed",
        Circle,
        "[board.esc]\nneutral_us = 1560\ndeadband_us = 60\n[truth.esc]\nneutral_us = 1500\n[operator]\narm = false\n",
    ),
    (
        "neutral 1500, believed 1560, armed",
        Circle,
        "[board.esc]\nneutral_us = 1560\ndeadband_us = 60\n[truth.esc]\nneutral_us = 1500\n",
    ),
    (
        "neutral 1500, believed 1560, emergency",
        Circle,
        "[board.esc]\nneutral_us = 1560\ndeadband_us = 60\n[truth.esc]\nneutral_us = 1500\n[operator]\narm = false\nemergency_stop_at_s = 8.0\n",
    ),
    (
        "neutral 1560, unarmed",
        Circle,
        "[truth.esc]\nneutral_us = 1560\n[operator]\narm = false\n",
    ),
    ("neutral 1560", Circle, "[truth.esc]\nneutral_us = 1560\n"),
    (
        "neutral 1440, unarmed",
        Circle,
        "[truth.esc]\nneutral_us = 1440\n[operator]\narm = false\n",
    ),
    ("neutral 1440", Circle, "[truth.esc]\nneutral_us = 1440\n"),
    (
        "learns neutral at restart, unarmed",
        Circle,
        "[board.esc]\nneutral_us = 1560\ndeadband_us = 60\n[truth.esc]\nkind = \"learns-neutral\"\nreboot_at_s = 4.0\n[operator]\narm = false\nemergency_stop_at_s = 8.0\n",
    ),
    (
        "learns neutral, restarts in mid-drive",
        Circle,
        "[truth.esc]\nkind = \"learns-neutral\"\nreboot_at_s = 6.0\n[operator]\ndisarm_at_s = 8.0\n",
    ),
    (
        "restarts in mid-drive",
        Circle,
        "[truth.esc]\nreboot_at_s = 6.0\n",
    ),
    (
        "forward-reverse, brake, unplugged",
        Straight("0.5"),
        "[board]\nfailsafe = \"brake\"\n[truth.esc]\nkind = \"forward-reverse\"\n[operator]\nunplug_at_s = 8.0\n",
    ),
    (
        "forward-reverse, coast, unplugged",
        Straight("0.5"),
        "[truth.esc]\nkind = \"forward-reverse\"\n[operator]\nunplug_at_s = 8.0\n",
    ),
    (
        "forward-reverse, disarmed",
        Straight("0.5"),
        "[truth.esc]\nkind = \"forward-reverse\"\n[operator]\ndisarm_at_s = 8.0\n",
    ),
    (
        "car, brake, unplugged",
        Straight("0.5"),
        "[board]\nfailsafe = \"brake\"\n[operator]\nunplug_at_s = 8.0\n",
    ),
    (
        "vesc, unplugged at 1.0 m/s",
        Straight("1.0"),
        "[truth.esc]\nkind = \"vesc\"\n[operator]\nunplug_at_s = 5.0\n",
    ),
    (
        "vesc, board reset at 1.0 m/s",
        Straight("1.0"),
        "[truth.esc]\nkind = \"vesc\"\n[operator]\nreset_board_at_s = 5.0\n",
    ),
    (
        "signal loss 1000 ms, unplugged, 1.0 m/s",
        Straight("1.0"),
        "[truth.esc]\nsignal_loss_ms = 1000\n[operator]\nunplug_at_s = 5.0\n",
    ),
    (
        "signal loss 1000 ms, reset, 1.0 m/s",
        Straight("1.0"),
        "[truth.esc]\nsignal_loss_ms = 1000\n[operator]\nreset_board_at_s = 5.0\n",
    ),
    (
        "signal loss 100 ms, reset, 1.0 m/s",
        Straight("1.0"),
        "[operator]\nreset_board_at_s = 5.0\n",
    ),
    (
        "throttle stuck, emergency stop",
        Straight("0.5"),
        "[truth.esc]\nstuck_from_s = 6.0\n[operator]\nemergency_stop_at_s = 8.0\n",
    ),
    (
        "throttle stuck, disarmed",
        Straight("0.5"),
        "[truth.esc]\nstuck_from_s = 6.0\n[operator]\ndisarm_at_s = 8.0\n",
    ),
    (
        "throttle stuck, unplugged",
        Straight("0.5"),
        "[truth.esc]\nstuck_from_s = 6.0\n[operator]\nunplug_at_s = 8.0\n",
    ),
    (
        "throttle stuck, relay, emergency stop",
        Straight("0.5"),
        "[board]\nkill_output = true\n[truth.esc]\nstuck_from_s = 6.0\n[operator]\nemergency_stop_at_s = 8.0\n",
    ),
    (
        "throttle stuck, relay, disarmed",
        Straight("0.5"),
        "[board]\nkill_output = true\n[truth.esc]\nstuck_from_s = 6.0\n[operator]\ndisarm_at_s = 8.0\n",
    ),
    (
        "throttle stuck, wall",
        Wall("0.5"),
        "[truth.esc]\nstuck_from_s = 6.0\n",
    ),
    // Drive train.
    (
        "rolls freely, wall at 0.5 m/s",
        Wall("0.5"),
        "[truth.drive_train]\nrolling_m_s2 = 0.3\nviscous_per_s = 0.2\n",
    ),
    (
        "rolls freely, wall at 1.0 m/s",
        Wall("1.0"),
        "[truth.drive_train]\nrolling_m_s2 = 0.3\nviscous_per_s = 0.2\n",
    ),
    (
        "rolls freely, disarmed at 1.0 m/s",
        Straight("1.0"),
        "[truth.drive_train]\nrolling_m_s2 = 0.3\nviscous_per_s = 0.2\n[operator]\ndisarm_at_s = 5.0\n",
    ),
    (
        "rolls freely, believed so, wall, 1.0 m/s",
        Wall("1.0"),
        "[truth.drive_train]\nrolling_m_s2 = 0.3\nviscous_per_s = 0.2\n[fence]\nbraking_m_s2 = 0.3\ncorners_m = [[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]]\n",
    ),
    (
        "slope 3 deg down, wall at 0.5 m/s",
        Wall("0.5"),
        "[truth.drive_train]\nslope_deg = 3.0\nslope_heading_deg = 180.0\n",
    ),
    (
        "slope 6 deg down, unarmed",
        Straight("0.5"),
        "[truth.drive_train]\nslope_deg = 6.0\nslope_heading_deg = 180.0\n[operator]\narm = false\n",
    ),
    ("slip 30 %", Circle, "[truth.drive_train]\nslip = 0.3\n"),
    (
        "slip 30 % from 6 s",
        Circle,
        "[truth.drive_train]\nslip = 0.3\nslip_from_s = 6.0\n",
    ),
    (
        "a blow forward, 0.5 m/s",
        Circle,
        "[truth.drive_train]\npush = { at_s = 6.0, speed_m_s = 0.5 }\n",
    ),
    (
        "pushed by hand for 3 s, unarmed",
        Straight("0.5"),
        "[truth.drive_train]\npush = { at_s = 3.0, speed_m_s = 0.3, for_s = 3.0 }\n[operator]\narm = false\n",
    ),
    // Motor pulses.
    (
        "6 mm a pulse",
        Circle,
        "[board.speed]\npulse_distance_um = 6000\n[truth.motor_sensor]\npulse_distance_um = 6000\n",
    ),
    (
        "12 mm a pulse",
        Circle,
        "[board.speed]\npulse_distance_um = 12000\n[truth.motor_sensor]\npulse_distance_um = 12000\n",
    ),
    (
        "25 mm a pulse",
        Circle,
        "[board.speed]\npulse_distance_um = 25000\n[truth.motor_sensor]\npulse_distance_um = 25000\n",
    ),
    (
        "30 mm a pulse",
        Circle,
        "[board.speed]\npulse_distance_um = 30000\n[truth.motor_sensor]\npulse_distance_um = 30000\n",
    ),
    (
        "65 mm a pulse",
        Circle,
        "[board.speed]\npulse_distance_um = 65000\n[truth.motor_sensor]\npulse_distance_um = 65000\n",
    ),
    (
        "pulse distance 6 mm, believed 3 mm",
        Circle,
        "[truth.motor_sensor]\npulse_distance_um = 6000\n",
    ),
    (
        "pulse distance 30 % more",
        Fast,
        "[truth.motor_sensor]\npulse_distance_um = 3900\n",
    ),
    (
        "pulse distance 30 % less",
        Fast,
        "[truth.motor_sensor]\npulse_distance_um = 2100\n",
    ),
    (
        "interference 5/s at standstill, unarmed",
        Circle,
        "[truth.motor_sensor]\nemi_standstill_hz = 5\n[operator]\narm = false\n",
    ),
    (
        "interference 5/s at standstill",
        Circle,
        "[truth.motor_sensor]\nemi_standstill_hz = 5\n",
    ),
    (
        "interference 20000/s while driving",
        Circle,
        "[truth.motor_sensor]\nemi_driven_hz = 20000\n",
    ),
    (
        "ringing, two edges for one",
        Circle,
        "[truth.motor_sensor]\nringing_edges = 1\n",
    ),
    // IMU.
    (
        "IMU turned 90 deg about z",
        Circle,
        "[truth.imu]\nmounting_deg = [0.0, 0.0, 90.0]\n",
    ),
    (
        "IMU turned 180 deg about z",
        Circle,
        "[truth.imu]\nmounting_deg = [0.0, 0.0, 180.0]\n",
    ),
    (
        "IMU upside down",
        Circle,
        "[truth.imu]\nmounting_deg = [180.0, 0.0, 0.0]\n",
    ),
    (
        "IMU tilted 10 deg",
        Circle,
        "[truth.imu]\nmounting_deg = [10.0, 0.0, 0.0]\n",
    ),
    (
        "IMU gyro 20 % more",
        Fast,
        "[truth.imu]\ngyro_scale = 1.2\n",
    ),
    ("IMU leak 2 s", Fast, "[truth.imu]\nleak_s = 2.0\n"),
    (
        "IMU vibration 3 m/s2",
        Fast,
        "[truth.imu]\nvibration_m_s2 = 3.0\nvibration_rad_s = 0.1\n",
    ),
    ("IMU torn samples, 1 %", Fast, "[truth.imu]\ntorn = 0.01\n"),
    (
        "dip of the ESC's supply",
        Circle,
        "[truth.battery]\ndip_at_s = 6.0\n",
    ),
    // Cameras.
    (
        "body yaw 3 deg",
        Fast,
        "[truth.cameras]\nbody_yaw_deg = 3.0\n",
    ),
    (
        "body yaw 10 deg",
        Circle,
        "[truth.cameras]\nbody_yaw_deg = 10.0\n",
    ),
    (
        "body yaw 30 deg",
        Circle,
        "[truth.cameras]\nbody_yaw_deg = 30.0\n",
    ),
    (
        "body yaw 180 deg",
        Circle,
        "[truth.cameras]\nbody_yaw_deg = 180.0\n",
    ),
    (
        "pivot 2 cm forward",
        Fast,
        "[truth.cameras]\npivot_m = [0.02, 0.0]\n",
    ),
    (
        "pivot 12 cm forward",
        Fast,
        "[truth.cameras]\npivot_m = [0.12, 0.0]\n",
    ),
    (
        "stamps 20 ms late",
        Fast,
        "[truth.cameras]\nstamp_bias_ms = 20.0\n",
    ),
    (
        "stamps 50 ms late",
        Fast,
        "[truth.cameras]\nstamp_bias_ms = 50.0\n",
    ),
    (
        "stamps 20 ms early",
        Fast,
        "[truth.cameras]\nstamp_bias_ms = -20.0\n",
    ),
    (
        "stamps 50 ms early",
        Fast,
        "[truth.cameras]\nstamp_bias_ms = -50.0\n",
    ),
    (
        "stamps drift 500 ppm",
        Fast,
        "[truth.cameras]\nstamp_drift_ppm = 500.0\n",
    ),
    (
        "wrong up axis",
        Circle,
        "[truth.cameras]\nup_axis = \"z\"\n",
    ),
    ("height 1.5 m", Circle, "[truth.cameras]\nheight_m = 1.5\n"),
    (
        "another body",
        Circle,
        "[truth.cameras]\nother_body = true\n",
    ),
    (
        "another body from 6 s",
        Circle,
        "[truth.cameras]\nother_body_from_s = 6.0\n",
    ),
    (
        "frozen poses for 1 s",
        Circle,
        "[truth.cameras]\nfrozen_from_s = 6.0\n",
    ),
    (
        "frozen poses before arming",
        Circle,
        "[truth.cameras]\nfrozen_from_s = 0.0\nfrozen_ms = 60000\n[operator]\narm = false\n",
    ),
    (
        "flip for good, armed again",
        Circle,
        "[truth.cameras]\nflip_from_s = 6.0\n[operator]\narm_again_at_s = 12.0\n",
    ),
    (
        "forged frames, 0.5 m off",
        Circle,
        "[truth.cameras]\nforged_from_s = 6.0\n",
    ),
    (
        "forged frames, drifting 0.1 m/s",
        Circle,
        "[truth.cameras]\nforged_from_s = 6.0\nforged_offset_m = [0.0, 0.0]\nforged_drift_m_s = [0.1, 0.0]\n",
    ),
    (
        "second network card",
        Circle,
        "[truth.cameras]\nsecond_network_card = true\n",
    ),
    (
        "no camera server",
        Circle,
        "[truth.cameras]\nserver_off = true\n",
    ),
    (
        "body of another name",
        Circle,
        "[truth.cameras]\nbody_name = \"Rover\"\n",
    ),
];

fn main() -> Result<(), Box<dyn Error>> {
    let mut board = "native".to_owned();
    let mut word = String::new();
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--board" => board = arguments.next().unwrap_or_default(),
            _ => word = argument,
        }
    }
    println!(
        "{:<41} {:>6} {:>7} {:>8} {:>7} {:>6} {:>6} {:>7} {:<12} reason",
        "car", "way m", "after m", "ended s", "max m/s", "min", "end", "fence m", "mode"
    );
    for (name, course, differs) in CARS {
        if !name.contains(&word) {
            continue;
        }
        match drive(*course, differs, &board) {
            Ok(summary) => print(name, &summary),
            Err(error) => println!("{name:<41} refused: {}", first_line(&error)),
        }
    }
    Ok(())
}

fn first_line(error: &impl ToString) -> String {
    error.to_string().lines().collect::<Vec<_>>().join(" ")
}

fn print(name: &str, summary: &Summary) {
    let ended = summary
        .ended_s
        .map_or_else(|| "-".to_owned(), |ended| format!("{ended:.2}"));
    println!(
        "{name:<41} {:>6.2} {:>7.2} {ended:>8} {:>7.2} {:>6.2} {:>6.2} {:>7.2} {:<12} {}",
        summary.way_m,
        summary.way_after_m,
        summary.speed_max_m_s,
        summary.speed_min_m_s,
        summary.speed_end_m_s,
        summary.clearance_min_m,
        summary.mode,
        summary.reason.unwrap_or("-"),
    );
}

fn drive(course: Course, differs: &str, board: &str) -> Result<Summary, Box<dyn Error>> {
    let fence = differs.contains("[fence]");
    let course = match course {
        Circle => CIRCLE.replace("RATE", "0.5"),
        Fast => CIRCLE.replace("RATE", "0.92"),
        Straight(speed) => STRAIGHT.replace("SPEED", speed),
        Wall(speed) if fence => STRAIGHT.replace("SPEED", speed),
        Wall(speed) => format!("{}{WALL}", STRAIGHT.replace("SPEED", speed)),
    };
    // With an operator, whatever happens is a result.
    let text = format!("{}{course}{differs}", COMMON.replace("BOARD", board));
    let scenario = Scenario::from_toml(&text, Path::new("other-cars.toml"))?;
    let options = RunOptions {
        summary: true,
        ..RunOptions::default()
    };
    let simulation = simulate_with(&scenario, options)?;
    simulation
        .summary
        .ok_or_else(|| "no summary".to_owned().into())
}
