//! The predictive outer loop.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use proptest::prelude::*;
use singletrack_control::{
    Circle, ConvexArea, DelayedMpc, MpcConfig, MpcError, MpcLoop, MpcVerdict, OuterLoop, Position,
    Reference, ReferencePoint, TrackingInput, Velocity,
};

const PERIOD: f64 = 0.01;
/// One stage of delay, and 25 stages of 30 ms.
type Loop = MpcLoop<4, 25>;

fn square(half: f64) -> ConvexArea {
    let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
    ConvexArea::new(&corners.map(|(x, y)| Position::new(x, y))).unwrap()
}

fn config() -> MpcConfig {
    MpcConfig {
        lag: 0.08,
        period: PERIOD,
        ticks_per_stage: 3,
        position_weight: 1.0,
        velocity_weight: 0.02,
        acceleration_weight: 0.004,
        max_speed: 1.2,
        max_acceleration: 2.0,
        max_deceleration: 2.0,
        area: Some(square(1.5)),
        iterations: 30,
        disturbance_gain: 0.02,
    }
}

/// P as the controller believes it to be, with a disturbance that it does not know.
struct Plant {
    point: Position,
    velocity: Velocity,
    pipeline: Vec<Velocity>,
    drift: Velocity,
    /// Turns velocities and commands on their way along with the reference, as a car does that
    /// is on its path.
    turns: bool,
    forward: Velocity,
}

impl Plant {
    fn at(point: Position) -> Self {
        Self {
            point,
            velocity: Velocity::zeros(),
            pipeline: vec![Velocity::zeros(); 3],
            drift: Velocity::zeros(),
            turns: false,
            forward: Velocity::x(),
        }
    }

    fn on_a_path(point: Position) -> Self {
        Self {
            turns: true,
            forward: Velocity::y(),
            ..Self::at(point)
        }
    }

    fn turn(&mut self, forward: Velocity) {
        let (cosine, sine) = (self.forward.dot(&forward), self.forward.perp(&forward));
        let turned =
            |v: &Velocity| Velocity::new(cosine * v.x - sine * v.y, sine * v.x + cosine * v.y);
        self.velocity = turned(&self.velocity);
        self.drift = turned(&self.drift);
        for command in &mut self.pipeline {
            *command = turned(command);
        }
        self.forward = forward;
    }

    fn advance(&mut self, command: Velocity) {
        self.pipeline.push(command);
        let obeyed = self.pipeline.remove(0);
        let after = obeyed + (self.velocity - obeyed) * (-PERIOD / 0.08_f64).exp();
        self.point += (obeyed + self.drift) * PERIOD + 0.08 * (self.velocity - after);
        self.velocity = after;
    }
}

/// A drive: at each tick the place of P, its error, the command and the verdict.
struct Ticks(Vec<(Position, f64, Velocity, MpcVerdict)>);

impl Ticks {
    fn settled(&self) -> f64 {
        let last = &self.0[self.0.len() - 200..];
        last.iter().map(|tick| tick.1).fold(0.0, f64::max)
    }

    fn count(&self, verdict: MpcVerdict) -> usize {
        self.0.iter().filter(|tick| tick.3 == verdict).count()
    }
}

fn drive(
    tracking: &mut Loop,
    plant: &mut Plant,
    reference: impl Fn(f64) -> ReferencePoint,
    seconds: f64,
) -> Ticks {
    let mut applied = Velocity::zeros();
    let ticks = (0..(seconds / PERIOD) as u32).map(|tick| {
        let time = f64::from(tick) * PERIOD;
        applied = tracking.step(&TrackingInput {
            point: plant.point,
            reference: &|ahead| reference(time + ahead),
            applied,
            period: PERIOD,
        });
        if plant.turns {
            plant.turn(reference(time).velocity.normalize());
        }
        plant.advance(applied);
        let error = reference(time + PERIOD)
            .position
            .map_or(0.0, |wanted| (plant.point - wanted).norm());
        (plant.point, error, applied, tracking.verdict())
    });
    Ticks(ticks.collect())
}

fn circle(radius: f64, rate: f64) -> impl Fn(f64) -> ReferencePoint {
    let circle = Reference::Circle(Circle::new(Position::origin(), radius, rate).unwrap());
    move |time| circle.at(time)
}

#[test]
fn a_circle_is_followed_through_lag_delay_and_a_drift() {
    let mut plant = Plant::on_a_path(Position::new(0.8, 0.0));
    let ideal = drive(
        &mut Loop::new(config()).unwrap(),
        &mut plant,
        circle(1.0, 0.8),
        15.0,
    );
    println!("{} m", ideal.settled());
    assert!(ideal.settled() < 0.003, "{} m", ideal.settled());
    assert_eq!(ideal.count(MpcVerdict::Braked), 0);

    // A drift of 5 cm/s across the path, once with the observer and once without.
    let with = |gain: f64| {
        let mut plant = Plant {
            drift: Velocity::new(0.05, 0.0),
            ..Plant::on_a_path(Position::new(0.8, 0.0))
        };
        let config = MpcConfig {
            disturbance_gain: gain,
            ..config()
        };
        let mut tracking = Loop::new(config).unwrap();
        drive(&mut tracking, &mut plant, circle(1.0, 0.8), 30.0).settled()
    };
    println!("{} m, {} m", with(0.02), with(0.0));
    assert!(with(0.02) < 0.003, "{} m", with(0.02));
    assert!(with(0.0) > 0.006, "{} m", with(0.0));
}

#[test]
fn a_reference_that_leaves_the_area_is_followed_to_its_edge() {
    let line = |time: f64| ReferencePoint {
        position: Some(Position::new(-1.0 + 0.8 * time, 0.2)),
        velocity: Velocity::new(0.8, 0.0),
    };
    let mut plant = Plant::at(Position::new(-1.0, 0.2));
    let ticks = drive(&mut Loop::new(config()).unwrap(), &mut plant, line, 8.0);
    let furthest = ticks.0.iter().map(|tick| tick.0.x).fold(-9.0, f64::max);
    assert!(furthest <= 1.5, "{furthest} m");
    assert!(furthest > 1.45, "{furthest} m");
    // It comes to rest there.
    assert!(ticks.0.last().unwrap().2.norm() < 0.02);
}

#[test]
fn a_reference_of_velocity_alone_is_passed_on_within_the_bounds() {
    let mut plant = Plant::at(Position::origin());
    let velocity = Velocity::new(5.0, 0.0);
    let fast = |_| ReferencePoint {
        position: None,
        velocity,
    };
    let ticks = drive(&mut Loop::new(config()).unwrap(), &mut plant, fast, 6.0);
    let largest = ticks.0.iter().map(|tick| tick.2.norm()).fold(0.0, f64::max);
    assert!((largest - 1.2).abs() < 1e-9, "{largest} m/s");
    assert!(
        plant.point.x <= 1.5 && plant.point.x > 1.3,
        "{}",
        plant.point
    );
}

#[test]
fn with_a_single_iteration_the_bounds_hold_and_the_verdict_says_that_it_is_not_the_best() {
    let once = MpcConfig {
        iterations: 1,
        ..config()
    };
    let mut plant = Plant::at(Position::new(-1.2, -1.2));
    let ticks = drive(
        &mut Loop::new(once).unwrap(),
        &mut plant,
        circle(1.0, 0.8),
        10.0,
    );
    assert!(ticks.count(MpcVerdict::Unconverged) > 0);
    for (place, _, command, _) in &ticks.0 {
        assert!(square(1.5).clearance(place) >= 0.0);
        assert!(command.norm() <= 1.2 + 1e-12);
    }
}

#[test]
fn after_a_reset_nothing_is_left_of_the_last_drive() {
    let fresh = Loop::new(config()).unwrap();
    let mut used = fresh.clone();
    drive(
        &mut used,
        &mut Plant::at(Position::origin()),
        circle(1.0, 1.0),
        2.0,
    );
    assert_ne!(used, fresh);
    used.reset();
    assert_eq!(used, fresh);
}

#[test]
fn settings_without_a_meaning_are_refused() {
    let refused = |change: fn(&mut MpcConfig)| {
        let mut config = config();
        change(&mut config);
        Loop::new(config).unwrap_err()
    };
    for (change, name) in [
        (
            (|config| config.max_speed = 0.0) as fn(&mut MpcConfig),
            "max_speed",
        ),
        (
            |config| config.max_acceleration = f64::NAN,
            "max_acceleration",
        ),
        (|config| config.lag = -0.1, "lag"),
        (|config| config.iterations = 0, "iterations"),
        (|config| config.ticks_per_stage = 0, "ticks_per_stage"),
    ] {
        assert!(
            matches!(refused(change), MpcError::NotPositive(found, _) if found == name),
            "{name}"
        );
    }
    assert_eq!(
        refused(|config| config.ticks_per_stage = 64),
        MpcError::Delay(64)
    );
    assert!(matches!(
        refused(|config| config.disturbance_gain = 1.5),
        MpcError::NotAShare(..)
    ));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// A plant that is as believed, from rest anywhere inside, after a reference that jumps
    /// about, also to where P must not be.
    #[test]
    fn no_applied_command_breaks_a_bound_whatever_is_asked(
        x in -1.4..1.4,
        y in -1.4..1.4,
        jumps in proptest::collection::vec((-4.0..4.0, -4.0..4.0, -3.0..3.0, -3.0..3.0), 1..12),
        iterations in 1..40usize,
        weight in 0.0005..0.1,
    ) {
        let config = MpcConfig {
            iterations,
            acceleration_weight: weight,
            ..config()
        };
        let mut plant = Plant::at(Position::new(x, y));
        let reference = |time: f64| {
            let index = (time / 0.4) as usize % jumps.len();
            let (x, y, u, v) = jumps[index];
            ReferencePoint {
                position: Some(Position::new(x, y)),
                velocity: Velocity::new(u, v),
            }
        };
        let mut tracking = Loop::new(config).unwrap();
        let ticks = drive(&mut tracking, &mut plant, reference, 6.0);
        let mut before = Velocity::zeros();
        for (place, _, command, verdict) in &ticks.0 {
            prop_assert!(command.norm() <= 1.2 + 1e-12, "{command}");
            prop_assert!((command - before).norm() <= 2.0 * PERIOD + 1e-12);
            // The observer takes the first ticks' rounding for a drift of nothing.
            let clearance = square(1.5).clearance(place);
            prop_assert!(clearance >= -1e-9, "{place}: {clearance} m, {verdict:?}");
            before = *command;
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20))]

    /// NaN and infinity brake the car; they neither panic nor become a command, and once they are
    /// over the loop works as before.
    #[test]
    fn no_input_makes_a_command_that_is_not_finite(
        bits in proptest::collection::vec(any::<u64>(), 4),
    ) {
        let number = |index: usize| f64::from_bits(bits[index]);
        let mut tracking = Loop::new(config()).unwrap();
        for _ in 0..5 {
            let answer = tracking.step(&TrackingInput {
                point: Position::new(number(0), 0.1),
                reference: &|_| ReferencePoint {
                    position: Some(Position::new(number(1), number(2))),
                    velocity: Velocity::new(number(3), 0.0),
                },
                applied: Velocity::new(0.5, 0.0),
                period: PERIOD,
            });
            prop_assert!(answer.norm() <= 1.2 + 1e-12, "{answer}");
        }
        let mut plant = Plant::on_a_path(Position::new(0.8, 0.0));
        let ticks = drive(&mut tracking, &mut plant, circle(1.0, 0.8), 12.0);
        prop_assert!(ticks.settled() < 0.01, "{} m", ticks.settled());
    }
}

#[test]
fn the_dead_time_decides_on_the_stages() {
    // Below half a stage of 30 ms it is a part of the lag.
    for (dead_time, late, ticks) in [(0.0, false, 3), (0.014, false, 3), (0.027, true, 3)] {
        let tracking = DelayedMpc::new(config(), dead_time).unwrap();
        let expected = MpcConfig {
            lag: if late { 0.08 } else { 0.08 + dead_time },
            ticks_per_stage: ticks,
            ..config()
        };
        let expected = if late {
            DelayedMpc::Late(MpcLoop::new(expected).unwrap())
        } else {
            DelayedMpc::Prompt(MpcLoop::new(expected).unwrap())
        };
        assert_eq!(tracking, expected, "{dead_time}");
    }
    assert_eq!(DelayedMpc::new(config(), 0.7), Err(MpcError::Delay(70)));
}
