//! The Riccati solver and the gains that it gives.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use nalgebra::{Matrix1, Matrix2, Matrix3, SMatrix, Vector2};
use proptest::prelude::*;
use singletrack_control::{LqiAxis, QuadraticRegulator, RiccatiError};

/// `SciPy`'s solutions: see `riccati/reference.py`.
const REFERENCE: &str = include_str!("riccati/reference.txt");

fn matrix<const R: usize, const C: usize>(case: &str, name: &str) -> SMatrix<f64, R, C> {
    let line = REFERENCE
        .lines()
        .find_map(|line| line.strip_prefix(&format!("{case} {name} {R} {C} ")))
        .unwrap();
    SMatrix::from_row_iterator(line.split(' ').map(|entry| entry.parse().unwrap()))
}

/// The largest deviation of cost and gain from `SciPy`'s, relative to the largest entry.
fn deviation<const N: usize, const M: usize>(case: &str) -> f64 {
    let solved = QuadraticRegulator::<N, M> {
        transition: matrix(case, "a"),
        input: matrix(case, "b"),
        state_weight: matrix(case, "q"),
        input_weight: matrix(case, "r"),
    }
    .solve()
    .unwrap();
    let (cost, gain) = (matrix(case, "x"), matrix(case, "k"));
    let of_cost = (solved.cost - cost).amax() / cost.amax();
    let of_gain = (solved.gain - gain).amax() / gain.amax();
    println!("{case}: cost {of_cost:.1e}, gain {of_gain:.1e}");
    of_cost.max(of_gain)
}

#[test]
fn costs_and_gains_are_those_of_scipy() {
    assert!(deviation::<2, 2>("integrator") < 1e-9);
    assert!(deviation::<2, 1>("double-integrator") < 1e-9);
    assert!(deviation::<3, 1>("lqi-ideal") < 1e-9);
    assert!(deviation::<3, 1>("lqi-motor") < 1e-9);
    assert!(deviation::<3, 1>("lqi-servo") < 1e-9);
    assert!(deviation::<3, 1>("lqi-slow") < 1e-9);
    assert!(deviation::<6, 2>("turning") < 1e-9);
    assert!(deviation::<3, 2>("unstable") < 1e-9);
}

#[test]
fn the_matrices_of_an_axis_are_those_that_scipy_discretised() {
    for (case, lag, integral, velocity, period) in [
        ("lqi-ideal", 0.0, 1.0, 0.0625, 0.01),
        ("lqi-motor", 0.08, 1.0, 0.0625, 0.01),
        ("lqi-servo", 0.04, 4.0, 0.02, 0.01),
        ("lqi-slow", 0.3, 0.1, 1.0, 0.02),
    ] {
        let axis = LqiAxis {
            lag,
            integral_weight: integral,
            error_weight: 1.0,
            velocity_weight: velocity,
        };
        let regulator = axis.regulator(period);
        let close = |a: f64| a < 1e-15;
        assert!(close(
            (regulator.transition - matrix::<3, 3>(case, "a")).amax()
        ));
        assert!(close((regulator.input - matrix::<3, 1>(case, "b")).amax()));
        assert!(close(
            (regulator.state_weight - matrix::<3, 3>(case, "q")).amax()
        ));
        assert!(close(
            (regulator.input_weight - matrix::<1, 1>(case, "r")).amax()
        ));
    }
}

#[test]
fn what_no_gain_can_settle_is_refused() {
    // The second state grows and the input does not reach it.
    let unreachable = QuadraticRegulator {
        transition: Matrix2::new(0.9, 0.0, 0.0, 1.1),
        input: Vector2::new(1.0, 0.0),
        state_weight: Matrix2::identity(),
        input_weight: Matrix1::new(1.0),
    };
    assert_eq!(unreachable.solve(), Err(RiccatiError::NotStabilisable));
    // An integrator that costs nothing is left alone for ever.
    let unweighted = QuadraticRegulator {
        transition: Matrix1::new(1.0),
        input: Matrix1::new(0.01),
        state_weight: Matrix1::new(0.0),
        input_weight: Matrix1::new(1.0),
    };
    assert_eq!(unweighted.solve(), Err(RiccatiError::NotStabilisable));
}

#[test]
fn weights_that_make_no_sense_are_refused() {
    let with = |transition: f64, weight: f64| {
        QuadraticRegulator {
            transition: Matrix1::new(transition),
            input: Matrix1::new(0.01),
            state_weight: Matrix1::new(1.0),
            input_weight: Matrix1::new(weight),
        }
        .solve()
    };
    assert_eq!(with(1.0, 0.0), Err(RiccatiError::InputWeight));
    assert_eq!(with(1.0, -1.0), Err(RiccatiError::InputWeight));
    assert_eq!(with(1.0, f64::NAN), Err(RiccatiError::NotFinite));
    assert_eq!(with(f64::INFINITY, 1.0), Err(RiccatiError::NotFinite));
    assert!(with(1.0, 1.0).is_ok());
}

proptest! {
    /// Stable and unstable systems with two inputs, of which one reaches every state.
    #[test]
    fn every_solution_satisfies_the_equation_and_settles_the_loop(
        entries in proptest::array::uniform9(-1.5..1.5),
        inputs in proptest::array::uniform6(-1.0..1.0),
        weights in proptest::array::uniform3(0.01..10.0),
        effort in 0.01..10.0,
    ) {
        let regulator = QuadraticRegulator {
            transition: Matrix3::from_row_slice(&entries),
            input: SMatrix::<f64, 3, 2>::from_row_slice(&inputs),
            state_weight: Matrix3::from_diagonal(&weights.into()),
            input_weight: Matrix2::from_diagonal_element(effort),
        };
        if let Ok(solved) = regulator.solve() {
            prop_assert!(regulator.residual(&solved) <= 1e-9 * (1.0 + solved.cost.amax()));
            let mut power = regulator.transition - regulator.input * solved.gain;
            for _ in 0..20 {
                power *= power;
            }
            prop_assert!(power.amax() < 1e-3, "{power}");
            // No cost is negative.
            prop_assert!(solved.cost.symmetric_eigenvalues().min() > 0.0);
        } else {
            // Only where the inputs hardly reach a direction.
            let reach = SMatrix::<f64, 3, 6>::from_columns(&[
                regulator.input.column(0).into(),
                regulator.input.column(1).into(),
                regulator.transition * regulator.input.column(0),
                regulator.transition * regulator.input.column(1),
                regulator.transition * regulator.transition * regulator.input.column(0),
                regulator.transition * regulator.transition * regulator.input.column(1),
            ]);
            prop_assert!((reach * reach.transpose()).symmetric_eigenvalues().min() < 1e-3);
        }
    }
}
