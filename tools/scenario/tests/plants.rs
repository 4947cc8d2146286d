//! The plants of a scenario: the whole pilot on the simulated car, board, line and cameras, in
//! virtual time; and the ideal one, against trajectories that two independent integrators agree on.

use std::{path::Path, sync::OnceLock};

use singletrack_core::config::{MarkerLoss, OuterLoopSection};
use singletrack_scenario::{
    simulate::{MarkerLoss as LostTicks, Row, Scenario, simulate},
    tracking::{Sample, Tracking, last_turn},
};
use singletrack_sim::ImuParameters;

use crate::estimation::{EstimationStudy, study};

fn circle() -> Scenario {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/circle-car.toml");
    Scenario::read(&path).unwrap()
}

fn with_feed_forward() -> Scenario {
    let mut scenario = circle();
    if let OuterLoopSection::Proportional { feed_forward, .. } = &mut scenario.outer_loop {
        *feed_forward = true;
    }
    scenario
}

fn tracking(rows: &[Row]) -> Tracking {
    let samples: Vec<_> = rows
        .iter()
        .map(|row| Sample {
            time: row.t,
            point: [row.x_p, row.y_p],
            reference: [row.x_ref, row.y_ref],
        })
        .collect();
    last_turn(&samples, [0.0, 0.0], 0.5).unwrap()
}

#[test]
fn the_circle_is_driven_on_the_amplitude_and_with_the_lag_of_unit_gain() {
    let tracking = tracking(&simulate(&circle()).unwrap().rows);
    assert!(
        (tracking.amplitude_m - 0.894_427).abs() < 0.02,
        "{tracking:?}"
    );
    assert!((tracking.lag_rad - 0.463_648).abs() < 0.06, "{tracking:?}");
}

#[test]
fn feed_forward_brings_p_within_a_centimetre() {
    let tracking = tracking(&simulate(&with_feed_forward()).unwrap().rows);
    assert!(tracking.rms_error_m <= 0.010, "{tracking:?}");
}

#[test]
fn losses_of_200_ms_every_2_s_leave_the_car_on_its_circle() {
    let mut scenario = circle();
    scenario.marker_loss = (1..20)
        .map(|index| LostTicks {
            first_tick: 200 * index,
            ticks: 20,
            repeat_ticks: 0,
        })
        .collect();
    let tracking = tracking(&simulate(&scenario).unwrap().rows);
    assert!(
        (tracking.amplitude_m - 0.894_427).abs() < 0.03,
        "{tracking:?}"
    );
    assert!((tracking.lag_rad - 0.463_648).abs() < 0.06, "{tracking:?}");
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_does_not() {
    let run = |seed| {
        let mut scenario = circle();
        scenario.run.duration_s = 3.0;
        scenario.run.seed = seed;
        simulate(&scenario)
            .unwrap()
            .rows
            .iter()
            .flat_map(|row| row.values().map(f64::to_bits))
            .collect::<Vec<_>>()
    };
    assert_eq!(run(7), run(7));
    assert_ne!(run(7), run(8));
}

/// Without losses: 0.2 mm / 0.1 deg cameras, 8 ms latency, consumer IMU that vibrates.
fn undisturbed() -> &'static EstimationStudy {
    static STUDY: OnceLock<EstimationStudy> = OnceLock::new();
    STUDY.get_or_init(|| study(&circle(), None, MarkerLoss::Hold).unwrap())
}

#[test]
fn position_is_estimated_to_2_mm() {
    assert!(
        undisturbed().errors.position_m <= 0.002,
        "{:?}",
        undisturbed()
    );
}

#[test]
fn yaw_is_estimated_to_a_third_of_a_degree() {
    assert!(
        undisturbed().errors.yaw_rad.to_degrees() <= 0.3,
        "{:?}",
        undisturbed()
    );
}

#[test]
fn sideslip_is_estimated_to_three_degrees() {
    // 0.45 m/s: a velocity of 2 cm/s to the side.
    assert!(
        undisturbed().errors.sideslip_rad.to_degrees() <= 3.0,
        "{:?}",
        undisturbed()
    );
}

#[test]
fn yaw_rate_is_estimated_to_the_vibration_of_the_gyro() {
    let imu = ImuParameters::default();
    let vibration = imu.vibration_rad_s + imu.vibration_rad_s_per_m_s * 0.45;
    assert!(
        undisturbed().errors.yaw_rate_rad_s <= 1.05 * vibration,
        "{:?}",
        undisturbed()
    );
}

#[test]
fn coasting_through_200_ms_losses_loses_less_than_holding() {
    let loss = Some("200ms@2s".parse().unwrap());
    let hold = study(&circle(), loss, MarkerLoss::Hold).unwrap();
    let coast = study(&circle(), loss, MarkerLoss::DeadReckon).unwrap();
    assert!(coast.worst_position_m < 0.025, "{coast:?}");
    assert!(hold.worst_position_m > 0.05, "{hold:?}");
}

/// With exact slip angles and cos δ the car needs 0.3226 rad on the circle of 0.894 m, with small
/// ones 0.3286 rad (the reproduction computes both).
#[test]
fn exact_slip_angles_need_less_steering_on_the_circle() {
    let steering = |slip_angles: &str| {
        let mut scenario = circle();
        let truth = format!("[vehicle]\ntyre_curve = \"linear\"\nslip_angles = \"{slip_angles}\"");
        scenario.truth = Some(toml::from_str(&truth).unwrap());
        scenario.supervisor = Some(toml::from_str("prove_first_metre = false").unwrap());
        let rows = simulate(&scenario).unwrap().rows;
        // Two turns of 12.57 s.
        let end = rows.last().unwrap().t;
        let last = rows.iter().filter(|row| row.t > end - 25.13);
        let [count, sum] = last.fold([0.0, 0.0], |[count, sum], row| {
            [count + 1.0, sum + row.steering]
        });
        sum / count
    };
    let [small, exact] = ["small", "exact"].map(steering);
    println!("{small} {exact}");
    assert!((small - 0.328_6).abs() < 0.001, "{small} rad");
    assert!((exact - 0.322_6).abs() < 0.001, "{exact} rad");
    assert!((small - exact - 0.006).abs() < 0.000_3, "{small} {exact}");
}

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
