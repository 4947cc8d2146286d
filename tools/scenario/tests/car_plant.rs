//! The whole pilot on the simulated car, board, line and cameras, in virtual time.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

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
