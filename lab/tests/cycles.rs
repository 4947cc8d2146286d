//! The unstable limit cycles of the stability analysis, against the simulator's ideal plant: a car
//! that starts with a yaw error on the edge of the basin of the straight motion swings on the
//! cycle for a while.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_analysis::stability::{Belief, Law, Saturation};
use singletrack_control::VehicleParameters;
use singletrack_lab::stability::{Subject, limit_cycles};
use singletrack_scenario::simulate::{Row, Scenario, simulate};

/// Straight on at 1 m/s under the law of the appendix, which is wrong by dl, from a yaw error in
/// degrees. None if the law becomes singular.
fn rows(deviation: f64, yaw: f64) -> Option<Vec<Row>> {
    let assumed = VehicleParameters::paper().front_axle_distance_m + deviation;
    let text = format!(
        r#"
law = {{ kind = "velocity-point", point_distance_m = 0.35, front_axle_distance_m = {assumed} }}
outer_loop = {{ kind = "open-loop" }}
reference = {{ kind = "velocity-steps", steps = [{{ duration_s = 99.0, v_x_m_s = 1.0, v_y_m_s = 0.0 }}] }}
start = {{ point_p_m = [0.0, 0.0], yaw_deg = {yaw} }}
control = {{ period_ms = 0 }}
plant = {{ kind = "ideal" }}
run = {{ duration_s = 16.0 }}
"#
    );
    let scenario: Scenario = toml::from_str(&text).unwrap();
    simulate(&scenario).ok().map(|simulation| simulation.rows)
}

/// Half the peak-to-peak steering angle of some rows at 20 Hz, in rad.
fn peak(rows: &[Row]) -> f64 {
    let largest = |sign: f64| {
        rows.iter()
            .map(|row| sign * row.steering)
            .fold(0.0, f64::max)
    };
    0.5 * (largest(1.0) + largest(-1.0))
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn a_car_on_the_edge_of_the_basin_swings_on_the_unstable_cycle() {
        let subject = Subject {
            vehicle: VehicleParameters::paper(),
            law: Law::VelocityPoint,
            belief: Belief::CentreOfMass,
            point_distance: 0.35,
        };
        for deviation in [0.012, 0.0128] {
            let at = deviation.to_string().parse().unwrap();
            let [(_, branch)] = &limit_cycles(&subject, 1.0, &at, Saturation::NONE).unwrap()[..]
            else {
                panic!("one branch");
            };
            let [cycle] = branch.cycles[..] else {
                panic!("{branch:?}");
            };
            let (mut decays, mut leaves) = (0.0, 80.0);
            for _ in 0..48 {
                let middle = 0.5 * (decays + leaves);
                match rows(deviation, middle) {
                    Some(rows) if peak(&rows[rows.len() - 30..]) < cycle.amplitude => {
                        decays = middle;
                    }
                    _ => leaves = middle,
                }
            }
            let rows = rows(deviation, decays).unwrap();
            let on_cycle = &rows[60..220];
            let amplitude = peak(on_cycle);
            let upward: Vec<f64> = on_cycle
                .windows(2)
                .filter(|pair| pair[0].yaw < 0.0 && pair[1].yaw >= 0.0)
                .map(|pair| {
                    pair[0].t - pair[0].yaw * (pair[1].t - pair[0].t) / (pair[1].yaw - pair[0].yaw)
                })
                .collect();
            let period = (upward.last().unwrap() - upward[0]) / (upward.len() - 1) as f64;
            println!("{cycle:?}: from {decays} degrees {amplitude} rad, {period} s");
            assert!(
                (amplitude / cycle.amplitude - 1.0).abs() < 0.005,
                "{amplitude} {cycle:?}"
            );
            assert!(
                (period / cycle.period - 1.0).abs() < 0.002,
                "{period} {cycle:?}"
            );
        }
    }
}
