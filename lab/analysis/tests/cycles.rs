//! Limit cycles against AUTO-07p (`data/limit_cycles.csv`, by `data/limit_cycles.auto`), which
//! discretises them by collocation.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_analysis::stability::{
    Belief, ClosedLoop, CycleBranch, Law, LimitCycle, Saturation, Servo, hopf_points,
};
use singletrack_control::{Tyres, VehicleParameters};

const P: f64 = 0.35;

/// The branch of the paper's car at a speed, which has one Hopf point.
fn branch(law: Law, speed: f64, saturation: Saturation, deviations: &[f64]) -> CycleBranch {
    let vehicle = VehicleParameters::paper();
    let closed_loop = ClosedLoop::new(vehicle, law, P, speed, 0.0)
        .unwrap()
        .saturating(saturation)
        .unwrap();
    let hopf = hopf_points(vehicle, law, Belief::CentreOfMass, P, speed).unwrap();
    closed_loop.limit_cycles(&hopf[0], deviations)
}

fn with(tyres: Tyres) -> Saturation {
    Saturation {
        tyres,
        ..Saturation::NONE
    }
}

/// The steering of the simulated car.
const STOPS: Saturation = Saturation {
    tyres: Tyres::Saturating,
    max_steering: 0.45,
    max_steering_rate: 5.0,
    ..Saturation::NONE
};

#[test]
fn the_steering_stop_bounds_the_amplitude_and_nothing_below_it() {
    let deviations = [-0.3, -0.2, -0.1];
    let free = branch(Law::FrontPoint, 3.0, with(Tyres::Saturating), &deviations);
    let stopped = branch(Law::FrontPoint, 3.0, STOPS, &deviations);
    assert_eq!(free.cycles[..2], stopped.cycles[..2]);
    assert!(free.cycles[2].amplitude > 0.6, "{free:?}");
    assert_eq!(stopped.cycles[2].amplitude, 0.45);
}

/// A branch turns back sharply where the motion first touches a stop.
#[test]
fn a_branch_goes_on_around_the_corner_of_a_first_contact() {
    let branch = branch(Law::FrontPoint, 2.0, STOPS, &[-0.46]);
    let stable: Vec<bool> = branch.cycles.iter().map(LimitCycle::is_stable).collect();
    assert_eq!(stable, [false, true], "{branch:?}");
    let corner = branch.folds[0];
    assert!((corner.deviation + 0.42806).abs() < 1e-4, "{corner:?}");
    assert!((corner.amplitude - 0.45).abs() < 1e-4, "{corner:?}");
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn cycles_equal_those_of_auto_07p() {
        type Row = (String, f64, String, f64, f64, f64, f64);
        let mut reader = csv::Reader::from_reader(&include_bytes!("data/limit_cycles.csv")[..]);
        let rows: Vec<Row> = reader.deserialize().map(Result::unwrap).collect();
        let mut compared = 0;
        for of_branch in rows.chunk_by(|one, other| (&one.0, one.1) == (&other.0, other.1)) {
            let law = Law::named(&of_branch[0].0).unwrap();
            let tyres = Tyres::named(&of_branch[0].2).unwrap();
            let mut deviations: Vec<f64> = of_branch.iter().map(|row| row.3).collect();
            deviations.sort_by(f64::total_cmp);
            deviations.dedup();
            let branch = branch(law, of_branch[0].1, with(tyres), &deviations);
            assert_eq!(branch.cycles.len(), of_branch.len(), "{branch:?}");
            for (cycle, row) in branch.cycles.iter().zip(of_branch) {
                assert_eq!(cycle.deviation, row.3);
                for (ours, theirs) in [
                    (cycle.amplitude, row.4),
                    (cycle.period, row.5),
                    (cycle.multiplier, row.6),
                ] {
                    let error = (ours / theirs - 1.0).abs();
                    assert!(error < 1e-6, "{cycle:?} {row:?}");
                }
                compared += 1;
            }
        }
        assert_eq!(compared, 25);
    }

    /// A multiplier is 1 where a branch turns back, also where the motion rests on a steering stop.
    #[test]
    fn at_a_fold_a_multiplier_is_one() {
        for (law, speed, saturation, folds) in [
            (Law::FrontPoint, 3.4, Saturation::NONE, 1),
            (Law::FrontPoint, 1.0, with(Tyres::Saturating), 1),
            (Law::VelocityPoint, 2.0, STOPS, 2),
        ] {
            let branch = branch(law, speed, saturation, &[]);
            assert_eq!(branch.folds.len(), folds, "{branch:?}");
            for fold in &branch.folds {
                assert!((fold.multiplier - 1.0).abs() < 1e-6, "{fold:?}");
            }
        }
    }

    /// With the lag and the dead times of the simulated car, the cycle of the stop is within reach of
    /// a yaw error that a servo which follows at once forgives.
    #[test]
    fn a_servo_narrows_the_basin_of_the_straight_motion() {
        let basin = |speed, saturation, servo| {
            ClosedLoop::new(VehicleParameters::paper(), Law::FrontPoint, P, speed, 0.0)
                .unwrap()
                .saturating(saturation)
                .unwrap()
                .basin(servo)
                .unwrap()
        };
        let servo = Some(Servo {
            lag: 0.04,
            dead_time: 0.02,
        });
        for (speed, at_once, narrowed) in
            [(2.5, 60.0..80.0, 42.0..50.0), (3.0, 50.0..60.0, 11.0..20.0)]
        {
            let ideal = basin(speed, STOPS, None);
            assert!(at_once.contains(&ideal.yaw.to_degrees()), "{ideal:?}");
            let real = basin(speed, STOPS, servo);
            assert!(narrowed.contains(&real.yaw.to_degrees()), "{real:?}");
            assert!(
                real.beyond.is_some_and(|amplitude| amplitude > 0.449),
                "{real:?}"
            );
        }
    }

    /// Subcritical with linear tyres: the cycles are unstable, on the side of the stable motion. With
    /// tyres that slide those of the law of the appendix are stable up to a fold.
    #[test]
    fn cycles_begin_at_the_hopf_point_with_the_stability_of_its_criticality() {
        let near = branch(Law::FrontPoint, 1.0, Saturation::NONE, &[-0.5899]);
        let [cycle] = near.cycles[..] else {
            panic!("{near:?}")
        };
        assert!(!cycle.is_stable() && cycle.multiplier < 1.01 && cycle.amplitude < 0.05);
        let sliding = branch(Law::VelocityPoint, 2.0, with(Tyres::Saturating), &[0.051]);
        let [cycle] = sliding.cycles[..] else {
            panic!("{sliding:?}")
        };
        assert!(cycle.is_stable() && cycle.multiplier > 0.9, "{cycle:?}");
    }
}
