//! The ideal plant against trajectories that two independent integrators agree
//! on to 1e-12, and against closed forms.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::path::Path;

use singletrack_scenario::simulate::{Row, Scenario, simulate};

/// Largest deviation allowed, in m and rad.
const TOLERANCE: f64 = 1e-6;

fn scenario(name: &str) -> Scenario {
    Scenario::read(
        &Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../scenarios")
            .join(name),
    )
    .unwrap()
}

/// Compares positions and angles with a reference file at its times.
fn assert_reproduces(scenario: &Scenario, reference: &str) {
    let rows = simulate(scenario).unwrap().rows;
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/reference")
        .join(reference);
    let mut compared = 0;
    for record in csv::Reader::from_path(path).unwrap().into_deserialize() {
        let expected: [f64; 15] = record.unwrap();
        let row = rows
            .iter()
            .find(|row| (row.t - expected[0]).abs() < 1e-9)
            .unwrap_or_else(|| panic!("no row at t = {}", expected[0]));
        for (column, (ours, theirs)) in row.values().iter().zip(&expected).enumerate() {
            assert!(
                (ours - theirs).abs() < TOLERANCE,
                "{reference}, t = {}, column {column}: {ours} against {theirs}",
                row.t
            );
        }
        compared += 1;
    }
    assert!(compared > 70, "only {compared} rows in {reference}");
}

#[test]
fn the_circle_is_reproduced() {
    assert_reproduces(&scenario("circle.toml"), "circle_a.csv");
}

#[test]
fn the_circle_with_the_centre_of_mass_believed_at_the_rear_axle_is_reproduced() {
    let mut scenario = scenario("circle.toml");
    scenario.law.front_axle_distance_m = 0.26;
    assert_reproduces(&scenario, "circle_a_dl_rear_estP.csv");
}

#[test]
fn the_velocity_steps_are_reproduced() {
    assert_reproduces(&scenario("steps.toml"), "steps_S1_dl0.csv");
}

#[test]
fn the_velocity_steps_with_the_centre_of_mass_believed_at_the_rear_axle_are_reproduced() {
    let mut scenario = scenario("steps.toml");
    scenario.law.front_axle_distance_m = 0.26;
    assert_reproduces(&scenario, "steps_S1_dl_rear.csv");
}

#[test]
fn the_sampled_circle_with_a_tick_of_delay_is_reproduced() {
    let mut scenario = scenario("circle-sampled.toml");
    scenario.marker_loss.clear();
    assert_reproduces(&scenario, "sampled_circle_delay1.csv");
}

#[test]
fn the_sampled_circle_that_holds_the_last_pose_is_reproduced() {
    assert_reproduces(
        &scenario("circle-sampled.toml"),
        "sampled_circle_delay1_hold200.csv",
    );
}

/// Amplitude and lag of P against the reference at a row.
fn amplitude_and_lag(row: &Row) -> (f64, f64) {
    let amplitude = row.x_p.hypot(row.y_p);
    let lag = singletrack_control::wrap(row.y_ref.atan2(row.x_ref) - row.y_p.atan2(row.x_p));
    (amplitude, lag)
}

#[test]
fn unit_gain_settles_on_the_amplitude_and_lag_of_a_first_order_low_pass() {
    let rows = simulate(&scenario("circle.toml")).unwrap().rows;
    let (amplitude, lag) = amplitude_and_lag(rows.last().unwrap());
    assert!((amplitude - 1.0 / 1.25_f64.sqrt()).abs() < 1e-9);
    assert!((lag - 0.5_f64.atan()).abs() < 1e-9);
}

#[test]
fn feed_forward_removes_the_error() {
    let mut scenario = scenario("circle.toml");
    let singletrack_core::config::OuterLoopSection::Proportional { feed_forward, .. } =
        &mut scenario.outer_loop
    else {
        panic!("the circle is tracked proportionally");
    };
    *feed_forward = true;
    let last = *simulate(&scenario).unwrap().rows.last().unwrap();
    assert!((last.x_p - last.x_ref).hypot(last.y_p - last.y_ref) < 1e-9);
}

#[test]
fn a_wrong_centre_of_mass_moves_p_by_twice_its_error_times_the_sine_of_half_the_turn() {
    let mut scenario = scenario("steps.toml");
    scenario.law.front_axle_distance_m = 0.26;
    for row in simulate(&scenario).unwrap().rows {
        let error = (row.x_p - row.x_ref).hypot(row.y_p - row.y_ref);
        let expected = 2.0 * (0.1232 * (row.yaw / 2.0).sin()).abs();
        assert!((error - expected).abs() < 1e-9, "t = {}", row.t);
    }
}

#[test]
fn the_velocity_point_law_linearises_its_own_point_exactly() {
    let mut scenario = scenario("steps.toml");
    scenario.law.kind = singletrack_core::config::LawKind::VelocityPoint;
    for row in simulate(&scenario).unwrap().rows {
        let error = (row.x_p - row.x_ref).hypot(row.y_p - row.y_ref);
        assert!(error < 1e-8, "t = {}: {error}", row.t);
    }
}

#[test]
fn beyond_the_last_velocity_step_the_ideal_integrator_goes_on_with_p() {
    let mut scenario = scenario("steps.toml");
    scenario.run.duration_s = 24.0;
    let last = *simulate(&scenario).unwrap().rows.last().unwrap();
    assert!((last.t - 24.0).abs() < 1e-9);
    assert!((last.x_ref + 4.5).abs() < 1e-9 && (last.y_ref - 0.6).abs() < 1e-9);
    assert!((last.x_p - last.x_ref).hypot(last.y_p - last.y_ref) < 1e-9);
}

#[test]
fn the_position_loop_follows_velocity_steps_by_their_integral() {
    let mut scenario = scenario("steps.toml");
    scenario.law.front_axle_distance_m = 0.2;
    scenario.outer_loop = singletrack_core::config::OuterLoopSection::Proportional {
        gain_per_s: [1.0, 1.0],
        feed_forward: true,
    };
    // The estimated P has no error to begin with; the true one is off by what
    // the estimate is.
    for row in simulate(&scenario).unwrap().rows {
        let off = (row.x_p - row.x_ref).hypot(row.y_p - row.y_ref);
        assert!(off < 0.2, "t = {}: {off}", row.t);
    }
}
