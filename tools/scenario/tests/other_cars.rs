//! Scenarios of cars that are not as their configuration says, and of operators.

use std::path::Path;

use singletrack_control::{SlipAngles, Tyres};
use singletrack_core::config::UpAxis;
use singletrack_scenario::simulate::{
    RunOptions, Scenario, Simulation, Summary, simulate, simulate_with, virtual_drive_config,
};
use singletrack_sim::EscKind;

/// Speed of the drives, in m/s.
const SPEED: f64 = 0.5;

/// Straight on along x. What a scenario adds comes last; the first metre need not prove
/// anything.
fn text(adds: &str) -> String {
    format!(
        r#"
        law = {{ kind = "front-point", point_distance_m = 0.35, front_axle_distance_m = 0.1368 }}
        outer_loop = {{ kind = "open-loop" }}
        start = {{ point_p_m = [0.5, 0.0], yaw_deg = 0.0 }}
        plant = {{ kind = "car" }}
        run = {{ duration_s = 4.0 }}
        [reference]
        kind = "velocity-steps"
        steps = [{{ duration_s = 60.0, v_x_m_s = {SPEED:?}, v_y_m_s = 0.0 }}]
        [control]
        period_ms = 10
        {adds}
        "#
    )
}

const PROVED: &str = "[supervisor]\nprove_first_metre = false\n";

fn scenario(adds: &str) -> Scenario {
    Scenario::from_toml(&text(adds), Path::new("test.toml")).unwrap()
}

fn error(adds: &str) -> String {
    Scenario::from_toml(&text(adds), Path::new("test.toml"))
        .unwrap_err()
        .to_string()
}

fn summarised(scenario: &Scenario) -> Simulation {
    let options = RunOptions {
        summary: true,
        ..RunOptions::default()
    };
    simulate_with(scenario, options).unwrap()
}

fn summary(adds: &str) -> Summary {
    let scenario = scenario(&format!("{PROVED}{adds}"));
    summarised(&scenario).summary.unwrap()
}

#[test]
fn the_truth_is_the_cars_alone() {
    let scenario = scenario(
        r#"
        [truth.servo]
        gain_us_per_rad = 800
        centre_us = 1540
        [truth.esc]
        kind = "forward-reverse"
        neutral_us = 1560
        signal_loss_ms = 1000
        stuck_from_s = 9.0
        [truth.drive_train]
        rolling_m_s2 = 0.3
        viscous_per_s = 0.2
        slope_deg = 0.0
        [truth.motor_sensor]
        pulse_distance_um = 6000
        [truth.imu]
        mounting_deg = [0.0, 0.0, 90.0]
        [truth.cameras]
        body_yaw_deg = 10.0
        pivot_m = [0.02, 0.0]
        stamp_bias_ms = 20.0
        "#,
    );
    let (believed, simulation) = virtual_drive_config(&scenario).unwrap();
    let car = simulation.car;
    assert_eq!(
        (car.servo.gain_us_per_rad, car.servo.centre_us),
        (800.0, 1540.0)
    );
    assert_eq!(
        (car.motor.kind, car.motor.neutral_us),
        (EscKind::ForwardReverse, 1560)
    );
    assert_eq!(car.motor.signal_loss_us, 1_000_000);
    assert_eq!(car.motor.stuck_from_s, Some(9.0));
    assert_eq!(
        (car.motor.coasting_m_s2, car.motor.viscous_per_s),
        (0.3, 0.2)
    );
    assert_eq!(car.motor_sensor.pulse_distance_um, 6000.0);
    assert_eq!(car.imu.mounting_deg, [0.0, 0.0, 90.0]);
    assert_eq!(simulation.cameras.car.yaw_rad, 10_f64.to_radians());
    let [forward, left] = simulation.cameras.car.pivot();
    assert!((forward - 0.02).abs() < 1e-12 && left.abs() < 1e-12);
    assert_eq!(simulation.cameras.stamp_bias_ms, 20.0);

    let board = believed.board.configuration();
    assert_eq!(
        (board.servo.gain_us_per_rad, board.servo.centre_us),
        (-800, 1500)
    );
    assert_eq!(
        (board.esc.neutral_us, board.speed.pulse_distance_um),
        (1500, 3000)
    );
    assert_eq!(believed.motion_capture.marker_yaw_rad, 0.0);
    assert_eq!(believed.motion_capture.marker_offset_m, [0.0; 2]);
}

#[test]
fn what_the_truth_leaves_out_follows_the_belief() {
    let scenario = scenario(
        r#"
        [board.speed]
        pulse_distance_um = 12000
        [board.esc]
        kind = "vesc"
        neutral_us = 1510
        [board.imu]
        forward = "-y"
        left = "+x"
        [motion_capture]
        rigid_body = "rover"
        up_axis = "z"
        marker_yaw_rad = 0.1
        marker_offset_m = [0.05, -0.01]
        [truth.esc]
        neutral_us = 1500
        "#,
    );
    let (believed, simulation) = virtual_drive_config(&scenario).unwrap();
    let car = simulation.car;
    assert_eq!(car.motor_sensor.pulse_distance_um, 12_000.0);
    assert_eq!(
        (car.motor.kind, car.motor.neutral_us),
        (EscKind::Vesc, 1500)
    );
    assert_eq!(believed.board.esc.neutral_us, 1510);
    assert_eq!(car.imu.mounting_deg, [0.0, 0.0, 90.0]);
    let body = &simulation.cameras.car;
    assert_eq!((body.name.as_str(), body.yaw_rad), ("rover", 0.1));
    let [forward, left] = body.pivot();
    assert!((forward - 0.05).abs() < 1e-12 && (left + 0.01).abs() < 1e-12);
    assert_eq!(simulation.cameras.up_axis, UpAxis::Z);
    assert_eq!(believed.motion_capture.up_axis, UpAxis::Z);
}

#[test]
fn a_section_of_the_daemon_may_be_given_in_part() {
    let (default, _) = virtual_drive_config(&scenario("")).unwrap();
    let scenario = Scenario::from_toml(
        &text(
            r#"
            stop_deceleration_m_s2 = 2.5
            delay_ticks = 1
            [board]
            failsafe = "brake"
            [board.speed]
            pulse_distance_um = 6000
            [limits]
            max_speed_m_s = 1
            [fence]
            corners_m = [[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]]
            [supervisor]
            hold_ms = 250
            [estimator]
            position_gate_m = 0.2
            [watch]
            stuck_samples = 40
            "#,
        ),
        Path::new("test.toml"),
    )
    .unwrap();
    let (config, _) = virtual_drive_config(&scenario).unwrap();
    assert_eq!(config.control.stop_deceleration_m_s2, 2.5);
    assert_eq!(config.limits.max_speed_m_s, 1.0);
    assert_eq!(config.board.speed.pulse_distance_um, 6000);
    assert_eq!(config.supervisor.hold_ms, 250);
    assert_eq!(config.estimator.position_gate_m, 0.2);
    assert_eq!(config.watch.stuck_samples, 40);
    assert_eq!(config.fence.corners_m[0], [-3.0, -3.0]);
    assert_eq!(config.fence.braking_m_s2, default.fence.braking_m_s2);
    // Everything else is as it was.
    assert_eq!(
        config.limits.max_steering_rad,
        default.limits.max_steering_rad
    );
    assert_eq!(config.board.servo, default.board.servo);
    assert_eq!(config.control.period_ms, 10);
}

/// The sections of the simulator's file: what they leave out follows the belief, and `[truth]`
/// replaces what they say.
#[test]
fn a_scenario_takes_the_sections_of_the_simulator() {
    let scenario = scenario(
        r#"
        [simulation.car]
        tyre_curve = "magic-formula"
        slip_angles = "exact"
        [simulation.car.vehicle]
        friction = 0.6
        [simulation.car.servo]
        lag_s = 0.06
        dead_time_us = 5000
        [simulation.car.motor]
        lag_s = 0.2
        neutral_us = 1510
        [simulation.car.imu]
        gyro_noise_rad_s = 0.01
        [simulation.board]
        clock_skew_ppm = -200
        [simulation.cameras]
        orientation_noise_rad = 0.004
        [simulation.wire.faults]
        drop = 0.001
        [board.servo]
        gain_us_per_rad = -700
        [truth.esc]
        neutral_us = 1520
        "#,
    );
    let (config, simulation) = virtual_drive_config(&scenario).unwrap();
    let car = &simulation.car;
    assert_eq!(car.tyre_curve, Tyres::MagicFormula);
    assert_eq!(car.slip_angles, SlipAngles::Exact);
    assert_eq!(car.vehicle.friction, 0.6);
    assert_eq!((car.servo.lag_s, car.servo.dead_time_us), (0.06, 5_000));
    assert_eq!((car.motor.lag_s, car.motor.neutral_us), (0.2, 1_520));
    assert_eq!(car.imu.gyro_noise_rad_s, 0.01);
    assert_eq!(simulation.board.clock_skew_ppm, -200);
    assert_eq!(simulation.cameras.orientation_noise_rad, 0.004);
    assert_eq!(simulation.wire.faults.drop, 0.001);
    // As believed, because nothing says otherwise.
    assert_eq!(car.servo.gain_us_per_rad, -700.0);
    assert_eq!(config.vehicle, scenario.vehicle);
    // A car that may differ has to prove itself.
    assert!(config.supervisor.prove_first_metre);
}

#[test]
fn unknown_keys_and_bad_values_are_named() {
    for (adds, words) in [
        ("colour = 1", ["control", "colour"]),
        ("[limits]\ncolour = 1", ["limits", "colour"]),
        ("[board.esc]\ncolour = 1", ["board", "colour"]),
        ("[supervisor]\ncolour = 1", ["supervisor", "colour"]),
        ("[fence]\ncorners_m = 1", ["[fence] corners_m", "a list"]),
        ("[truth]\ncolour = 1", ["drive_train", "colour"]),
        ("[truth.esc]\ncolour = 1", ["signal_loss_ms", "colour"]),
        ("[truth.esc]\nkind = \"boat\"", ["boat", "forward-reverse"]),
        (
            "[truth.esc]\nneutral_us = 300",
            ["truth.esc.neutral_us", "300"],
        ),
        (
            "[truth.drive_train]\nslip = 1.0",
            ["truth.drive_train.slip", "1"],
        ),
        (
            "[truth.vehicle]\ntyre_curve = \"round\"",
            ["round", "magic-formula"],
        ),
        (
            "[truth.vehicle]\nslip_angles = \"round\"",
            ["round", "exact"],
        ),
        ("[simulation]\ncolour = 1", ["simulation", "colour"]),
        (
            "[simulation.car.servo]\ncolour = 1",
            ["simulation", "colour"],
        ),
        (
            "[simulation.cameras]\nperiod_us = 1",
            ["cameras.period_us", "1"],
        ),
        ("[simulation]\nseed = 1", ["simulation.seed", "run.seed"]),
        (
            "[simulation.car.start]\nx_m = 1.0",
            ["simulation.car.start", "[start]"],
        ),
        (
            "[simulation.board]\nkind = \"uno\"",
            ["simulation.board.kind", "plant.board"],
        ),
        ("[operator]\ncolour = 1", ["unplug_at_s", "colour"]),
        (
            "[operator]\ndisarm_at_s = -1.0",
            ["operator.disarm_at_s", "-1"],
        ),
    ] {
        let error = error(adds);
        for word in words {
            assert!(
                error.contains(word),
                "{adds:?}: {word:?} is not in {error:?}"
            );
        }
    }
}

#[test]
fn the_ideal_plant_has_none_of_it() {
    for adds in [
        "[truth]",
        "[simulation]",
        "[operator]",
        "[board]",
        "[fence]",
        "[supervisor]",
        "[estimator]",
        "[watch]",
        "stop_deceleration_m_s2 = 2.0",
    ] {
        let text = text(adds).replace("\"car\"", "\"ideal\"");
        let error = Scenario::from_toml(&text, Path::new("test.toml")).unwrap_err();
        assert!(error.to_string().contains("ideal"), "{adds}: {error}");
    }
}

#[test]
fn a_drive_to_the_end_of_the_run_has_not_ended() {
    let summary = summary("");
    assert!(summary.armed);
    assert_eq!((summary.mode, summary.reason), ("driving", None));
    assert_eq!((summary.ended_s, summary.way_after_m), (None, 0.0));
    // 4 s, less the acceleration.
    assert!((1.8..2.0).contains(&summary.way_m), "{summary:?}");
    assert!((summary.speed_end_m_s - SPEED).abs() < 0.02);
    assert_eq!(summary.speed_min_m_s, 0.0);
    // G starts 0.4868 m behind P, and the hall ends at 10 m.
    let clearance = 10.0 - (0.5 - 0.4868) - summary.way_m;
    assert!((summary.clearance_min_m - clearance).abs() < 0.02);
}

#[test]
fn a_summary_does_not_change_the_drive() {
    let scenario = scenario("");
    let with = summarised(&scenario);
    let without = simulate(&scenario).unwrap();
    assert_eq!(with.rows, without.rows);
    assert_eq!(with.summary, summarised(&scenario).summary);
}

#[test]
fn an_operator_ends_the_drive_at_a_time_of_the_run() {
    for (action, mode, reason) in [
        ("disarm_at_s", None, "requested"),
        ("emergency_stop_at_s", Some("fault"), "emergency-stop"),
        ("unplug_at_s", Some("disconnected"), "imu-silent"),
        ("reset_board_at_s", None, "imu-silent"),
    ] {
        let summary = summary(&format!("[operator]\n{action} = 2.0\n"));
        assert!(summary.armed);
        // The link and the IMU are given up after a tenth of a second.
        let ended_s = summary.ended_s.unwrap();
        assert!((2.0..2.2).contains(&ended_s), "{action}: {summary:?}");
        assert_eq!(summary.reason, Some(reason), "{action}: {summary:?}");
        assert!(
            mode.is_none_or(|mode| summary.mode == mode),
            "{action}: {summary:?}"
        );
        assert_eq!(summary.speed_end_m_s, 0.0, "{action}");
        assert!(
            (0.01..0.4).contains(&summary.way_after_m),
            "{action}: {summary:?}"
        );
    }
}

#[test]
fn a_cable_that_is_plugged_in_again_brings_the_board_back() {
    let away = summary("[operator]\nunplug_at_s = 1.0\n");
    let back = summary("[operator]\nunplug_at_s = 1.0\nplug_at_s = 1.5\n");
    assert_eq!(away.mode, "disconnected");
    assert_ne!(back.mode, "disconnected");
    let again = summary("[operator]\ndisarm_at_s = 1.0\narm_again_at_s = 3.0\n");
    assert_eq!(again.mode, "driving", "{again:?}");
    assert_eq!(again.ended_s, None);
    assert!(again.way_after_m > 0.01);
}

#[test]
fn nobody_arms_and_time_counts_from_the_start() {
    let standing = summary("[operator]\narm = false\n");
    assert!(!standing.armed);
    assert_eq!((standing.mode, standing.ended_s), ("ready", None));
    assert_eq!((standing.way_m, standing.way_after_m), (0.0, 0.0));
}

#[test]
fn an_unarmed_car_that_drives_stops_after_a_metre_whatever_braking_is_configured() {
    // The true neutral is below the one that is believed, beyond band and breakaway: the
    // car drives as soon as the board is configured.
    for (neutral_us, speed_m_s, braking_m_s2) in [
        (1560, 0.3, 1.4),
        (1560, 0.3, 0.3),
        (1560, 0.3, 0.1),
        (1600, 0.63, 0.3),
        (1640, 0.9, 0.3),
    ] {
        let deadband_us = neutral_us - 1500;
        let adds = format!(
            "{PROVED}[operator]\narm = false\n[board.esc]\nneutral_us = {neutral_us}\n\
             deadband_us = {deadband_us}\nmax_us = 1900\n[truth.esc]\nneutral_us = 1500\n\
             [fence]\nbraking_m_s2 = {braking_m_s2}\n"
        );
        let text = text(&adds).replace("duration_s = 4.0", "duration_s = 12.0");
        let scenario = Scenario::from_toml(&text, Path::new("test.toml")).unwrap();
        let runs = summarised(&scenario).summary.unwrap();
        assert!(!runs.armed && runs.way_m == 0.0);
        let rolls_m = runs.speed_max_m_s * (0.1 + runs.speed_max_m_s / 2.0);
        assert!(
            (0.8..1.05 + rolls_m).contains(&runs.way_after_m),
            "{runs:?}"
        );
        assert!((runs.speed_max_m_s - speed_m_s).abs() < 0.1, "{runs:?}");
        assert_eq!(runs.speed_end_m_s, 0.0, "{runs:?}");
    }
}

#[test]
fn a_drive_that_does_not_start_is_a_result_only_if_one_is_asked_for() {
    let outside = "[fence]\ncorners_m = [[4.0, 4.0], [5.0, 4.0], [5.0, 5.0], [4.0, 5.0]]\n";
    let scenario = scenario(outside);
    let error = simulate(&scenario).unwrap_err().to_string();
    assert!(error.contains("outside-fence"), "{error}");
    let refused = summarised(&scenario);
    let summary = refused.summary.unwrap();
    assert_eq!(
        (summary.armed, summary.reason),
        (false, Some("outside-fence"))
    );
    assert!(summary.clearance_min_m < -4.0);
    // A row for every twentieth of a second, but for those before the first tick.
    assert_eq!(refused.rows.len(), 80);
    let operated = simulate(&self::scenario(&format!("{outside}[operator]\n"))).unwrap();
    assert!(!operated.summary.unwrap().armed);
}

#[test]
fn a_summary_looks_at_five_seconds_after_the_end() {
    // The throttle is stuck at the speed of the drive.
    let summary = summary("[truth.esc]\nstuck_from_s = 3.0\n[operator]\ndisarm_at_s = 3.5\n");
    assert!((3.5..3.6).contains(&summary.ended_s.unwrap()));
    assert!((summary.speed_end_m_s - SPEED).abs() < 0.02, "{summary:?}");
    let expected = 5.0 * SPEED;
    assert!((summary.way_after_m - expected).abs() < 0.1, "{summary:?}");
}

#[test]
fn timed_truth_counts_from_the_first_driving_tick() {
    let scenario = scenario(&format!(
        "{PROVED}[truth.drive_train]\npush = {{ at_s = 2.0, speed_m_s = 0.4 }}\n"
    ));
    let rows = summarised(&scenario).rows;
    let way_before = |t: f64| rows.iter().find(|row| row.t >= t).unwrap().x_g;
    let before = (way_before(2.0) - way_before(1.9)) / 0.1;
    let after = (way_before(2.1) - way_before(2.0)) / 0.1;
    assert!(
        (before - SPEED).abs() < 0.02 && after > SPEED + 0.2,
        "{before} {after}"
    );
}

#[test]
fn a_push_before_anybody_arms_moves_the_car() {
    let summary = summary(
        "[operator]\narm = false\n\
         [truth.drive_train]\npush = { at_s = 1.0, speed_m_s = 0.2, for_s = 1.0 }\n",
    );
    assert!((summary.way_after_m - 0.22).abs() < 0.03, "{summary:?}");
    assert_eq!(summary.speed_end_m_s, 0.0);
}

#[test]
fn friction_of_its_own_lets_a_car_roll_farther() {
    let way = |adds: &str| {
        let adds = format!("{adds}[operator]\nemergency_stop_at_s = 3.0\n");
        summary(&adds).way_after_m
    };
    let own = way("");
    let free = way("[truth.drive_train]\nrolling_m_s2 = 0.3\nviscous_per_s = 0.2\n");
    // v²/2a with a from 1.0 to 1.3 m/s², and from 0.3 to 0.4 m/s².
    assert!((0.09..0.16).contains(&own), "{own}");
    assert!((0.31..0.45).contains(&free), "{free}");
}

#[test]
fn a_camera_server_that_can_not_be_heard_keeps_the_car_from_driving() {
    for cause in [
        "second_network_card = true",
        "server_off = true",
        "body_name = \"rover\"",
    ] {
        let summary = summary(&format!("[truth.cameras]\n{cause}\n"));
        assert!(!summary.armed, "{cause}");
        assert!(summary.reason.is_some(), "{cause}");
    }
}

#[test]
fn an_inverted_servo_turns_the_car_the_other_way() {
    // Left is wanted: P starts to the right of where the reference goes.
    let yaw = |adds: &str| {
        let text = text(&format!("{PROVED}{adds}")).replace("v_y_m_s = 0.0", "v_y_m_s = 0.2");
        let scenario = Scenario::from_toml(&text, Path::new("test.toml")).unwrap();
        let rows = summarised(&scenario).rows;
        rows.iter()
            .map(|row| row.yaw)
            .fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a })
    };
    assert!(yaw("") > 0.1);
    assert!(yaw("[truth.servo]\ngain_us_per_rad = 800\n") < -0.1);
}
