//! The outer loop with integral action.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::f64::consts::TAU;

use nalgebra::{Matrix1, Matrix2, Matrix3, SMatrix, Vector2};
use proptest::prelude::*;
use singletrack_control::{
    Circle, LqiAxis, LqiConfig, LqiError, LqiLoop, OuterLoop, Position, QuadraticRegulator,
    Reference, ReferencePoint, RiccatiError, TrackingInput, Velocity,
};

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

const PERIOD: f64 = 0.01;

fn axis(lag: f64) -> LqiAxis {
    LqiAxis {
        lag,
        integral_weight: 1.0,
        error_weight: 1.0,
        velocity_weight: 0.0625,
    }
}

fn config() -> LqiConfig {
    LqiConfig {
        along: axis(0.08),
        across: axis(0.04),
        integral_limit: 0.5,
        turn_rate: 3.0,
        period: PERIOD,
    }
}

fn circle(rate: f64) -> Reference {
    Reference::Circle(Circle::new(Position::origin(), 1.0, rate).unwrap())
}

/// P with a lag of first order along and across the reference, both of which have a gain that
/// is wrong and the across one a drift.
struct Plant {
    point: Position,
    /// Along and across.
    velocity: Velocity,
    gain: f64,
    drift: f64,
}

impl Plant {
    fn at(point: Position) -> Self {
        Self {
            point,
            velocity: Velocity::zeros(),
            gain: 1.0,
            drift: 0.0,
        }
    }

    fn advance(&mut self, applied: Velocity, forward: Velocity) {
        let left = Velocity::new(-forward.y, forward.x);
        for _ in 0..10 {
            let step = PERIOD / 10.0;
            for (index, axis, lag) in [(0, forward, 0.08), (1, left, 0.04)] {
                let change = axis.dot(&applied) * self.gain - self.velocity[index];
                self.velocity[index] += change * step / lag;
            }
            let velocity = self.velocity.x * forward + (self.velocity.y + self.drift) * left;
            self.point += velocity * step;
        }
    }
}

/// The errors (m) over `seconds` on the reference, with every command limited to `most` m/s.
fn drive(
    tracking: &mut impl OuterLoop,
    plant: &mut Plant,
    reference: &Reference,
    seconds: f64,
    most: f64,
) -> Vec<f64> {
    let mut applied = Velocity::zeros();
    (0..(seconds / PERIOD) as u32)
        .map(|tick| {
            let time = f64::from(tick) * PERIOD;
            let ahead = |ahead: f64| reference.at(time + ahead);
            let wanted = tracking.step(&TrackingInput {
                point: plant.point,
                reference: &ahead,
                applied,
                period: PERIOD,
            });
            applied = wanted * (most / wanted.norm()).min(1.0);
            let now = reference.at(time);
            plant.advance(applied, now.velocity.normalize());
            (plant.point - reference.at(time + PERIOD).position.unwrap()).norm()
        })
        .collect()
}

fn settled(errors: &[f64]) -> f64 {
    errors[errors.len() - 100..]
        .iter()
        .copied()
        .fold(0.0, f64::max)
}

#[test]
fn a_wrong_gain_and_a_drift_are_removed_on_a_circle() {
    let mut plant = Plant {
        gain: 0.9,
        drift: 0.05,
        ..Plant::at(Position::new(1.0, 0.0))
    };
    let mut tracking = LqiLoop::new(config()).unwrap();
    let errors = drive(&mut tracking, &mut plant, &circle(1.0), 20.0, 10.0);
    assert!(settled(&errors) < 1e-3, "{} m", settled(&errors));
    // Without the integral it stays where the gain balances the drift.
    let weak = LqiConfig {
        integral_limit: 0.0,
        ..config()
    };
    let mut plant = Plant {
        gain: 0.9,
        drift: 0.05,
        ..Plant::at(Position::new(1.0, 0.0))
    };
    let errors = drive(
        &mut LqiLoop::new(weak).unwrap(),
        &mut plant,
        &circle(1.0),
        20.0,
        10.0,
    );
    assert!(settled(&errors) > 0.02, "{} m", settled(&errors));
}

#[test]
fn a_command_that_is_limited_does_not_wind_the_integral_up() {
    let mut plant = Plant::at(Position::new(-2.0, 0.0));
    let mut tracking = LqiLoop::new(config()).unwrap();
    let errors = drive(&mut tracking, &mut plant, &circle(0.5), 15.0, 0.8);
    assert!(settled(&errors) < 1e-3, "{} m", settled(&errors));
    // Once it is there it stays: an integral that had wound up would carry it past.
    let arrived = errors.iter().position(|error| *error < 0.05).unwrap();
    let beyond = errors[arrived..].iter().copied().fold(0.0, f64::max);
    assert!(beyond < 0.2, "{beyond} m");
}

#[test]
fn a_reference_without_a_position_is_passed_on() {
    let mut tracking = LqiLoop::new(config()).unwrap();
    let velocity = Velocity::new(0.3, -0.4);
    let answer = tracking.step(&TrackingInput {
        point: Position::new(3.0, 4.0),
        reference: &|_| ReferencePoint {
            position: None,
            velocity,
        },
        applied: Velocity::zeros(),
        period: PERIOD,
    });
    assert_eq!(answer, velocity);
}

#[test]
fn after_a_reset_nothing_is_left_of_the_last_drive() {
    let fresh = LqiLoop::new(config()).unwrap();
    let mut used = fresh;
    let mut plant = Plant::at(Position::origin());
    drive(&mut used, &mut plant, &circle(1.0), 2.0, 1.0);
    assert_ne!(used, fresh);
    used.reset();
    assert_eq!(used, fresh);
}

#[test]
fn settings_without_a_meaning_are_refused() {
    let mut of_weight = config();
    of_weight.along.velocity_weight = 0.0;
    assert_eq!(
        LqiLoop::new(of_weight),
        Err(RiccatiError::InputWeight.into())
    );
    // Nothing that has no weight is ever brought back.
    let mut of_integral = config();
    of_integral.across.integral_weight = 0.0;
    assert_eq!(
        LqiLoop::new(of_integral),
        Err(RiccatiError::NotStabilisable.into())
    );
    for broken in [f64::NAN, -1.0] {
        let mut of_lag = config();
        of_lag.along.lag = broken;
        assert_eq!(LqiLoop::new(of_lag), Err(RiccatiError::NotFinite.into()));
        let mut of_turn = config();
        of_turn.turn_rate = broken;
        assert_eq!(LqiLoop::new(of_turn), Err(RiccatiError::NotFinite.into()));
        let mut of_period = config();
        of_period.period = broken;
        assert_eq!(LqiLoop::new(of_period), Err(RiccatiError::NotFinite.into()));
    }
}

proptest! {
    /// The whole loop, both axes coupled by the turn of the frame, by its eigenvalues: what is
    /// accepted settles at the stated rate of turn, at every slower one, and to either side.
    #[test]
    fn a_loop_that_is_accepted_settles_at_every_rate_of_turn_to_the_stated_one(
        turn_rate in 0.0..12.0,
        share in -1.0..1.0,
        lag in 0.0..0.3,
        difference in 0.0..0.2,
        velocity_weight in 0.03..1.0,
    ) {
        let [along, across] = [lag, lag + difference]
            .map(|lag| LqiAxis { velocity_weight, ..axis(lag) });
        let settings = LqiConfig { along, across, turn_rate, ..config() };
        let largest = largest_eigenvalue(&settings, share * turn_rate);
        match LqiLoop::new(settings) {
            Ok(_) => prop_assert!(largest < 1.0, "accepted: {largest}"),
            Err(LqiError::Turns(rate)) => {
                prop_assert_eq!(rate, turn_rate);
                let stated = largest_eigenvalue(&settings, turn_rate);
                // What settles slower than in 44 minutes is refused as well.
                prop_assert!(stated > 1.0 - 1e-4, "refused: {}", stated);
            }
            Err(other) => prop_assert!(false, "{other}"),
        }
    }
}

/// The largest absolute value of the coupled loop's eigenvalues, with both axes in the frame that
/// turns by `rate`: integral, error and velocity of one axis, then of the other.
fn largest_eigenvalue(settings: &LqiConfig, rate: f64) -> f64 {
    let (sine, cosine) = (rate * PERIOD).sin_cos();
    let mut closed = SMatrix::<f64, 6, 6>::zeros();
    for (place, axis) in [(0, settings.along), (3, settings.across)] {
        let regulator = axis.regulator(PERIOD);
        let own = regulator.transition - regulator.input * regulator.solve().unwrap().gain;
        closed.fixed_view_mut::<3, 3>(place, place).copy_from(&own);
    }
    let mut turned = SMatrix::<f64, 6, 6>::identity();
    for state in 1..3 {
        turned[(state, state)] = cosine;
        turned[(state + 3, state + 3)] = cosine;
        turned[(state, state + 3)] = sine;
        turned[(state + 3, state)] = -sine;
    }
    (turned * closed)
        .complex_eigenvalues()
        .iter()
        .map(|value| value.re.hypot(value.im))
        .fold(0.0, f64::max)
}

#[test]
fn a_loop_that_is_too_slow_for_the_turns_is_refused() {
    let slow = LqiAxis {
        velocity_weight: 0.78,
        ..axis(0.2)
    };
    let of = |turn_rate| LqiConfig {
        along: slow,
        across: slow,
        turn_rate,
        ..config()
    };
    assert!(LqiLoop::new(of(2.5)).is_ok());
    assert_eq!(LqiLoop::new(of(3.0)), Err(LqiError::Turns(3.0)));
}

#[test]
fn a_turn_of_the_reference_counts_in_its_own_frame() {
    // A circle, started at four places: the errors are the same.
    let of = |quarter: u32| {
        let angle = f64::from(quarter) * TAU / 4.0;
        let turned = |vector: Velocity| {
            Velocity::new(
                angle.cos() * vector.x - angle.sin() * vector.y,
                angle.sin() * vector.x + angle.cos() * vector.y,
            )
        };
        let own = circle(1.0);
        let reference = |time: f64| {
            let point = own.at(time);
            ReferencePoint {
                position: point.position.map(|at| Position::from(turned(at.coords))),
                velocity: turned(point.velocity),
            }
        };
        let mut tracking = LqiLoop::new(config()).unwrap();
        let mut plant = Plant::at(Position::from(turned(Velocity::new(0.8, 0.0))));
        let mut applied = Velocity::zeros();
        let mut last = 0.0;
        for tick in 0..100 {
            let time = f64::from(tick) * PERIOD;
            applied = tracking.step(&TrackingInput {
                point: plant.point,
                reference: &|ahead| reference(time + ahead),
                applied,
                period: PERIOD,
            });
            plant.advance(applied, reference(time).velocity.normalize());
            last = (plant.point - reference(time + PERIOD).position.unwrap()).norm();
        }
        last
    };
    for quarter in 1..4 {
        assert!((of(quarter) - of(0)).abs() < 1e-12);
    }
}

#[test]
fn a_place_that_is_not_finite_leaves_nothing_behind() {
    let mut tracking = LqiLoop::new(config()).unwrap();
    for broken in [f64::NAN, f64::INFINITY] {
        let answer = tracking.step(&TrackingInput {
            point: Position::new(broken, 0.0),
            reference: &|ahead| circle(1.0).at(ahead),
            applied: Velocity::new(broken, 0.0),
            period: PERIOD,
        });
        assert!(!answer.x.is_finite());
    }
    let mut plant = Plant::at(Position::new(0.9, 0.0));
    let errors = drive(&mut tracking, &mut plant, &circle(1.0), 20.0, 10.0);
    assert!(settled(&errors) < 1e-3, "{} m", settled(&errors));
}
