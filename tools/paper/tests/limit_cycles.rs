//! The first unstable speeds of the linear loop with a servo, against the limit cycles of the
//! whole pilot on the simulated car, board and cameras, in virtual time; and none where the
//! pilot compensates the actuators.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_analysis::stability::{Belief, Law};
use singletrack_control::VehicleParameters;
use singletrack_paper::stability::{Subject, TimingArgs, first_unstable};
use singletrack_scenario::simulate::{Row, Scenario, simulate};

/// The speeds over the first unstable one, and how long each is driven, in s. The first one
/// includes the start; the last one leaves the oscillation time to grow from the noise.
const STEPS: [(f64, f64); 3] = [(0.75, 3.5), (0.85, 2.0), (1.12, 5.0)];
/// The end of each step that is looked at, in s.
const WINDOW_S: f64 = 1.2;

/// What the speeds near the first unstable ones need.
const USUAL: &str = r"
[limits]
max_speed_m_s = 1.85
max_steering_rad = 0.45

[board.speed]
max_forward_mm_s = 2600
";

/// Near its first unstable speed the loop amplifies the vibration of the IMU as much as a limit
/// cycle swings.
const QUIET: &str = r"
[truth.imu]
vibration_m_s2 = 0.0
vibration_m_s2_per_m_s = 0.0
vibration_rad_s = 0.0
vibration_rad_s_per_m_s = 0.0
";

/// What the top speed of the simulated motor needs.
const FAST: &str = r"
stop_deceleration_m_s2 = 3.0

[limits]
max_speed_m_s = 2.3
max_steering_rad = 0.45

[board.esc]
max_us = 2000

[board.speed]
feed_forward_us_per_m_s = 150
max_forward_mm_s = 3000
";

/// Straight on, with P at a distance: a start at the first speed, in m/s, then each of the
/// others, each for its time, in s.
///
/// The speed changes in small steps, since a large disturbance, such as that of a start, can
/// throw the car into the limit cycle below the first unstable speed.
fn straight_on(
    point_distance: f64,
    steps: [(f64, f64); 3],
    compensated: bool,
    adds: &str,
) -> Scenario {
    let duration = steps.iter().map(|(_, duration)| duration).sum::<f64>() - 0.1;
    let steps = steps.map(|(speed, duration)| {
        format!("{{ duration_s = {duration}, v_x_m_s = {speed}, v_y_m_s = 0.0 }}")
    });
    let text = format!(
        r#"
[law]
kind = "front-point"
point_distance_m = {point_distance}
front_axle_distance_m = 0.1368

[outer_loop]
kind = "open-loop"

[reference]
kind = "velocity-steps"
steps = [{}]

[start]
point_p_m = [-9.0, 0.0]
yaw_deg = 0.0

[board]
max_pose_age_ms = 1000

[supervisor]
prove_first_metre = false
hold_ms = 100
hold_distance_m = 0.1
blind_ms = 100
blind_distance_m = 0.1

[compensation]
clock = {compensated}
actuation = {compensated}

[plant]
kind = "car"

[run]
duration_s = {duration}

[control]
period_ms = 10
{adds}
"#,
        steps.join(", ")
    );
    toml::from_str(&text).unwrap()
}

/// The standard deviation of the wheels' angle at the end of each step, in rad.
fn oscillation(rows: &[Row], steps: [(f64, f64); 3]) -> [f64; 3] {
    let mut end = -0.1;
    steps.map(|(_, duration)| {
        end += duration;
        let angles: Vec<f64> = rows
            .iter()
            .filter(|row| row.t > end - WINDOW_S && row.t < end)
            .map(|row| row.steering)
            .collect();
        let count = angles.len() as f64;
        let mean = angles.iter().sum::<f64>() / count;
        let square: f64 = angles.iter().map(|angle| (angle - mean).powi(2)).sum();
        (square / count).sqrt()
    })
}

/// Drives a scenario to its end.
fn swings(scenario: &Scenario, steps: [(f64, f64); 3]) -> [f64; 3] {
    let simulation = simulate(scenario).unwrap();
    assert!(simulation.notes.is_empty(), "{:?}", simulation.notes);
    oscillation(&simulation.rows, steps)
}

#[test]
fn limit_cycles_begin_at_the_first_unstable_speeds_of_the_linear_loop() {
    for p in [0.03, 0.04, 0.05] {
        let subject = Subject {
            vehicle: VehicleParameters::paper(),
            law: Law::FrontPoint,
            belief: Belief::CentreOfMass,
            point_distance: p,
        };
        let timing = TimingArgs::simulated_car();
        let first = first_unstable(&subject, timing, &[0.0], p)
            .unwrap()
            .unwrap();
        let [plain, compensated] = [false, true].map(|compensated| {
            let steps = STEPS.map(|(part, duration)| (part * first, duration));
            let adds = format!("{USUAL}{QUIET}");
            swings(&straight_on(p, steps, compensated, &adds), steps)
        });
        println!("p = {p} m: first unstable at {first:.3} m/s; {plain:.4?} rad");
        // Noise below, a limit cycle above.
        assert!(plain[0] < 0.04 && plain[1] < 0.04, "{plain:?}");
        assert!(plain[2] > 0.15, "{plain:?}");
        println!("  compensated: {compensated:.4?} rad");
        assert!(
            compensated.iter().all(|swing| *swing < 0.04),
            "{compensated:?}"
        );
    }
}

/// A car of another structure: Pacejka's tyres, exact slip angles.
const OTHER: &str = r#"
[truth.vehicle]
tyre_curve = "magic-formula"
slip_angles = "exact"
"#;

/// Beyond the first unstable speed of the loop without a prediction, as fast as the simulated
/// motor drives, the compensated car is as quiet as below it, also with tyres and slip angles
/// that its model does not have. Without compensation it is in a limit cycle there.
#[test]
fn with_compensation_there_is_no_limit_cycle_up_to_the_top_speed_of_the_car() {
    let steps = [(1.0, 2.0), (1.6, 2.0), (2.2, 4.5)];
    for (p, unstable_from) in [(0.05, 1.3), (0.1, 1.9)] {
        let subject = Subject {
            vehicle: VehicleParameters::paper(),
            law: Law::FrontPoint,
            belief: Belief::CentreOfMass,
            point_distance: p,
        };
        let first = |timing| first_unstable(&subject, timing, &[0.0], p).unwrap();
        let plain = first(TimingArgs::simulated_car());
        assert!(
            plain.is_some_and(|speed| speed < unstable_from),
            "{plain:?}"
        );
        let predicting = TimingArgs {
            predict: true,
            ..TimingArgs::simulated_car()
        };
        assert_eq!(first(predicting), None);
        for adds in [FAST.to_owned(), format!("{FAST}{OTHER}")] {
            for (adds, most) in [(format!("{adds}{QUIET}"), 0.01), (adds, 0.04)] {
                let compensated = swings(&straight_on(p, steps, true, &adds), steps);
                println!("p = {p} m: compensated {compensated:.4?} rad, at most {most}");
                assert!(
                    compensated.iter().all(|swing| *swing < most),
                    "{compensated:?}"
                );
            }
        }
        let plain = swings(&straight_on(p, steps, false, FAST), steps);
        println!("p = {p} m: plain {plain:.4?} rad");
        assert!(plain[2] > 0.06, "{plain:?}");
    }
}
