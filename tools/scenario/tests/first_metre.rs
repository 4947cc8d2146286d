//! Cars that are not as their configuration says: the first metre finds it.

use std::path::Path;

use singletrack_scenario::simulate::{RunOptions, Scenario, Summary, simulate_with};

/// The way within which a contradiction ends the drive, m.
const MOST_WAY: f64 = 0.5;
/// The highest speed of the first metre, m/s, and what the board's speed loop adds to it.
const SPEED: f64 = 0.3 + 0.05;

/// What a body shows that is turned far on its car.
const SLIDES: &str = "sideslip-implausible";

const CIRCLE: &str = "[outer_loop]\nkind = \"proportional\"\ngain_per_s = [1.0, 1.0]\n\
    feed_forward = true\n[reference]\nkind = \"circle\"\nradius_m = 1.0\n\
    angular_velocity_rad_s = 0.5\n[start]\npoint_p_m = [1.0, 0.0]\nyaw_deg = 90.0\n";
const STRAIGHT: &str = "[outer_loop]\nkind = \"open-loop\"\n[reference]\nkind = \"velocity-steps\"\n\
    steps = [{ duration_s = 60.0, v_x_m_s = 0.8, v_y_m_s = 0.0 }]\n[start]\n\
    point_p_m = [0.0, 0.0]\nyaw_deg = 0.0\n";

fn drive(course: &str, differs: &str) -> Summary {
    let text = format!(
        "[law]\nkind = \"front-point\"\npoint_distance_m = 0.35\nfront_axle_distance_m = 0.1368\n\
         [control]\nperiod_ms = 10\n[plant]\nkind = \"car\"\n[run]\nduration_s = 8.0\n\
         {course}{differs}"
    );
    let scenario = Scenario::from_toml(&text, Path::new("car.toml")).unwrap();
    let options = RunOptions {
        summary: true,
        ..RunOptions::default()
    };
    simulate_with(&scenario, options).unwrap().summary.unwrap()
}

#[test]
fn the_first_metre_of_an_unproved_car_finds_what_contradicts_within_half_a_metre() {
    for (differs, reason) in [
        (
            "[truth.servo]\ngain_us_per_rad = 800\n",
            "steering-reversed",
        ),
        ("[truth.servo]\nstuck_from_s = 0.0\n", "steering-differs"),
        ("[truth.imu]\ngyro_scale = -1.0\n", "gyro-differs"),
        (
            "[truth.imu]\nmounting_deg = [0.0, 0.0, 90.0]\n",
            "accelerometer-differs",
        ),
        (
            "[truth.imu]\nmounting_deg = [0.0, 0.0, 180.0]\n",
            "accelerometer-differs",
        ),
        (
            "[truth.imu]\nmounting_deg = [0.0, 0.0, -90.0]\n",
            "accelerometer-differs",
        ),
        ("[truth.cameras]\nbody_yaw_deg = 10.0\n", "body-yaw-wrong"),
        ("[truth.cameras]\nbody_yaw_deg = -10.0\n", "body-yaw-wrong"),
        ("[truth.cameras]\nbody_yaw_deg = 30.0\n", "body-yaw-wrong"),
        ("[truth.cameras]\nbody_yaw_deg = 90.0\n", "body-yaw-wrong"),
        ("[truth.cameras]\nbody_yaw_deg = 180.0\n", "body-yaw-wrong"),
        (
            "[truth.motor_sensor]\npulse_distance_um = 6000\n",
            "motor-speed-mismatch",
        ),
        (
            "[truth.motor_sensor]\npulse_distance_um = 2000\n",
            "motor-speed-mismatch",
        ),
    ] {
        for course in [CIRCLE, STRAIGHT] {
            let summary = drive(course, differs);
            // A body at a right angle shows in the sideslip of a straight line first, some centimetres
            // on.
            let slides = differs.contains("= 90.0\n")
                && course == STRAIGHT
                && summary.reason == Some(SLIDES)
                && summary.way_m + summary.way_after_m <= 0.1;
            assert!(
                summary.reason == Some(reason) || slides,
                "{differs}{course}: {summary:?}"
            );
            let way = summary.way_m + summary.way_after_m;
            assert!(way <= MOST_WAY, "{differs}{course}: {summary:?}");
            // With half of the pulses the car drives twice as fast until that shows.
            let speed = if reason == "motor-speed-mismatch" {
                2.0 * SPEED
            } else {
                SPEED
            };
            assert!(
                summary.speed_max_m_s <= speed,
                "{differs}{course}: {summary:?}"
            );
        }
    }
}

#[test]
fn a_wheelbase_that_is_wrong_by_a_quarter_shows_and_one_by_a_tenth_does_not() {
    for (share, reason) in [(0.75, Some("steering-differs")), (0.9, None), (1.1, None)] {
        let [front, rear] = [0.1368, 0.1232].map(|axle| share * axle);
        let believed = format!(
            "[vehicle]\nmass_kg = 1.9\nyaw_inertia_kg_m2 = 0.0251\nfriction = 0.25\n\
             front_cornering_stiffness_n_rad = 58.085\nrear_cornering_stiffness_n_rad = 130.805\n\
             front_axle_distance_m = {front}\nrear_axle_distance_m = {rear}\n\
             [truth.vehicle]\nfront_axle_distance_m = 0.1368\nrear_axle_distance_m = 0.1232\n"
        );
        for course in [CIRCLE, STRAIGHT] {
            let summary = drive(course, &believed);
            assert_eq!(summary.reason, reason, "{share} {course}: {summary:?}");
        }
    }
}

#[test]
fn a_servo_whose_trim_is_wrong_shows_on_a_straight() {
    let summary = drive(STRAIGHT, "[truth.servo]\ncentre_us = 1612\n");
    assert_eq!(summary.reason, Some("steering-differs"), "{summary:?}");
    assert!(
        summary.way_m + summary.way_after_m <= MOST_WAY,
        "{summary:?}"
    );
}

#[test]
fn what_shows_before_arming_refuses_it() {
    for (differs, reason) in [
        (
            "[truth.imu]\nmounting_deg = [180.0, 0.0, 0.0]\n",
            "imu-tilted",
        ),
        (
            "[truth.imu]\nmounting_deg = [0.0, 12.0, 0.0]\n",
            "imu-tilted",
        ),
        (
            "[motion_capture.pose]\nheight_m = [0.05, 0.2]\n[truth.cameras]\nheight_m = 0.4\n",
            "pose-height",
        ),
        (
            "[truth.cameras]\nfrozen_from_s = 0.0\nfrozen_ms = 60000\n[operator]\narm = false\n",
            "pose-frozen",
        ),
        // The bound on the error of a mid-exposure is half an echo's way, over 0.1 ms.
        (
            "[watch]\nmax_capture_uncertainty_ms = 0.05\n",
            "capture-time-uncertain",
        ),
        ("[truth.imu]\nself_test = 11\n", "imu-fault"),
        ("[truth.battery]\ndivider_open = true\n", "battery-open"),
    ] {
        let summary = drive(CIRCLE, differs);
        assert!(!summary.armed, "{differs}: {summary:?}");
        assert_eq!(summary.reason, Some(reason), "{differs}: {summary:?}");
    }
}

#[test]
fn a_car_that_rolls_freely_is_refused_or_stops_inside_its_fence() {
    const ROLLS: &str = "[truth.drive_train]\nrolling_m_s2 = 0.3\nviscous_per_s = 0.2\n";
    let fence = |braking: f64| {
        format!(
            "[fence]\ncorners_m = [[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]]\n\
             braking_m_s2 = {braking}\n"
        )
    };
    let refused = drive(STRAIGHT, &format!("{}{ROLLS}", fence(1.4)));
    assert_eq!(refused.reason, Some("brakes-less-than-configured"));
    assert!(
        refused.way_m < 1.0 && refused.clearance_min_m > 0.0,
        "{refused:?}"
    );
    let known = drive(STRAIGHT, &format!("{}{ROLLS}", fence(0.28)));
    assert_eq!(known.reason, Some("outside-fence"), "{known:?}");
    assert!(known.clearance_min_m > 0.0, "{known:?}");
}

#[test]
fn a_throttle_that_is_stuck_is_a_stop_that_is_not_obeyed() {
    for end in ["disarm_at_s = 4.0\n", "emergency_stop_at_s = 4.0\n"] {
        let differs = format!("[truth.esc]\nstuck_from_s = 3.0\n[operator]\n{end}");
        let summary = drive(STRAIGHT, &differs);
        assert_eq!(summary.reason, Some("stop-not-obeyed"), "{summary:?}");
        assert_eq!(summary.mode, "fault", "{summary:?}");
    }
}

#[test]
fn a_proved_car_whose_mounting_changes_is_found_while_it_drives() {
    for (differs, reason) in [
        (
            "[truth.cameras]\nbody_yaw_deg = 10.0\n",
            "sideslip-implausible",
        ),
        (
            "[truth.imu]\nmounting_deg = [0.0, 0.0, 90.0]\n",
            "accelerometer-differs",
        ),
        (
            "[truth.imu]\nmounting_deg = [0.0, 0.0, 180.0]\n",
            "accelerometer-differs",
        ),
        ("[truth.servo]\ngain_us_per_rad = 800\n", "steering-differs"),
    ] {
        let differs = format!("[supervisor]\nprove_first_metre = false\n{differs}");
        let summary = drive(CIRCLE, &differs);
        assert_eq!(summary.reason, Some(reason), "{summary:?}");
        assert!(summary.way_m < 1.5, "{summary:?}");
    }
}

#[test]
fn a_contradiction_is_not_driven_again_by_another_arm_request() {
    const AGAIN: &str = "[operator]\narm_again_at_s = 5.0\n";
    for pulse_distance_um in [1_000, 1_500, 2_000, 4_500, 6_000] {
        let differs =
            format!("[truth.motor_sensor]\npulse_distance_um = {pulse_distance_um}\n{AGAIN}");
        for course in [CIRCLE, STRAIGHT] {
            let summary = drive(course, &differs);
            assert_eq!(
                (summary.mode, summary.reason),
                ("idle", Some("motor-speed-mismatch")),
                "{differs}{course}: {summary:?}"
            );
            assert!(
                summary.ended_s < Some(5.0),
                "{differs}{course}: {summary:?}"
            );
        }
    }
}

#[test]
fn a_reference_that_is_too_slow_to_prove_the_brakes_keeps_the_car_slow() {
    const SLOW_THEN_FAST: &str = "[outer_loop]\nkind = \"open-loop\"\n[reference]\n\
        kind = \"velocity-steps\"\nsteps = [{ duration_s = 3.0, v_x_m_s = 0.1, v_y_m_s = 0.0 }, \
        { duration_s = 9.0, v_x_m_s = 1.0, v_y_m_s = 0.0 }]\n[start]\n\
        point_p_m = [0.0, 0.0]\nyaw_deg = 0.0\n";
    const ROLLS: &str = "[truth.drive_train]\nrolling_m_s2 = 0.25\nviscous_per_s = 0.1\n";
    let summary = drive(SLOW_THEN_FAST, ROLLS);
    assert_eq!(
        summary.reason,
        Some("brakes-less-than-configured"),
        "{summary:?}"
    );
    assert!(summary.speed_max_m_s <= SPEED, "{summary:?}");
}

#[test]
fn a_calibrated_car_may_be_rolled_either_way_by_hand() {
    for (speed, yaw_deg, reason) in [
        (0.3, 0.0, None),
        (-0.3, 0.0, None),
        (0.3, 20.0, Some("body-yaw-wrong")),
        (-0.3, 20.0, Some("body-yaw-wrong")),
    ] {
        let differs = format!(
            "[operator]\narm = false\n[truth.cameras]\nbody_yaw_deg = {yaw_deg}\n\
             [truth.drive_train]\npush = {{ at_s = 4.0, speed_m_s = {speed}, for_s = 1.5 }}\n"
        );
        let summary = drive(STRAIGHT, &differs);
        assert_eq!(summary.reason, reason, "{differs}: {summary:?}");
    }
}
