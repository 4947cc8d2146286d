//! The outer loop with integral action.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::f64::consts::TAU;

use nalgebra::SMatrix;
use proptest::prelude::*;
use singletrack_control::{
    Circle, LqiAxis, LqiConfig, LqiError, LqiLoop, OuterLoop, Position, Reference, ReferencePoint,
    RiccatiError, TrackingInput, Velocity,
};

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
