//! Steady circles with tyres that slide, against a simulation with the law and the car model.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

mod steady;

use nalgebra::Complex;
use singletrack_control::{
    FrontPointLaw, Motion, RelaxedSingleTrack, SingleTrackState, VehicleParameters, direction,
};

use steady::{Circle, SteadyCircle};

const P: f64 = 0.35;
/// The step of the simulation, in s.
const STEP: f64 = 2e-4;
/// Steps from one sample to the next.
const EVERY: i32 = 250;

fn circle(radius: f64) -> Circle {
    Circle::new(VehicleParameters::paper(), P, radius).unwrap()
}

#[test]
fn on_a_circle_of_a_metre_the_tyres_let_go_at_1_595_metres_per_second() {
    let fold = circle(1.0).fold();
    println!("{fold:?}");
    assert!((fold.point_speed - 1.5958).abs() < 1e-4, "{fold:?}");
    // With linear tyres and at the paper's speed nothing slides much.
    let slow = circle(1.0).at_speed(0.5).unwrap();
    assert!(slow.tyre_use < 0.1, "{slow:?}");
    assert_eq!(circle(1.0).at_speed(fold.point_speed + 1e-6), None);
}

#[test]
fn a_steady_circle_satisfies_its_equations() {
    for radius in [0.7, 1.0, 3.0] {
        let circle = circle(radius);
        let fastest = circle.fold().point_speed;
        for part in [0.1, 0.5, 0.9, 0.99, 0.999_9] {
            let steady = circle.at_speed(part * fastest).unwrap();
            assert!((steady.point_speed / (part * fastest) - 1.0).abs() < 1e-12);
            assert!(
                steady.residual() < 1e-9,
                "{steady:?}: {}",
                steady.residual()
            );
        }
    }
}

#[test]
fn circles_are_stable_up_to_the_fold_where_an_eigenvalue_vanishes() {
    let circle = circle(1.0);
    let fold = circle.fold();
    for speed in [0.3, 0.5, 1.0, 1.4, 1.5, 1.55, 1.58, 1.59, 1.595] {
        let eigenvalues = circle.at_speed(speed).unwrap().eigenvalues();
        println!("{speed}: {eigenvalues:.4?}");
        assert!(eigenvalues[3].re < 0.0, "{speed}: {eigenvalues:?}");
    }
    let at_fold = fold.eigenvalues();
    println!("fold {}: {at_fold:.6?}", fold.point_speed);
    let smallest = at_fold
        .iter()
        .map(|value| value.norm())
        .fold(f64::INFINITY, f64::min);
    assert!(smallest < 1e-3 * at_fold[0].norm(), "{at_fold:?}");
}

/// Samples of the steering angle after a small disturbance, in a simulation: the law, the car
/// with saturating tyres, and the velocity of P that turns.
fn simulated_steering(circle_radius: f64, steady: &SteadyCircle) -> Vec<f64> {
    let vehicle = VehicleParameters::paper();
    let law = FrontPointLaw::new(vehicle.front_axle_distance_m, P, vehicle.wheelbase_m()).unwrap();
    let model = RelaxedSingleTrack::new(vehicle);
    let turning = steady.point_speed / circle_radius;
    let h = STEP;
    // Course of P's velocity, then the car.
    let slope = |course: f64, [yaw, r, beta, steering]: [f64; 4]| {
        let motion = Motion {
            yaw,
            yaw_rate: r,
            sideslip: beta,
        };
        let wanted = direction(course) * steady.point_speed;
        let command = law.command(&motion, steering, &wanted).unwrap();
        let state = SingleTrackState {
            yaw,
            yaw_rate: r,
            sideslip: beta,
            ..SingleTrackState::default()
        };
        let rate = model.derivative(&state, command.speed, steering);
        [
            rate.yaw,
            rate.yaw_rate,
            rate.sideslip,
            command.steering_rate,
        ]
    };
    let rest = [
        steady.yaw_off_velocity,
        steady.yaw_rate,
        steady.sideslip,
        steady.steering,
    ];
    let mut state = rest;
    state[3] += 1e-5;
    let sum = |a: [f64; 4], b: [f64; 4], by: f64| {
        let mut sum = a;
        sum.iter_mut().zip(b).for_each(|(x, s)| *x += by * s);
        sum
    };
    let mut samples = Vec::new();
    for step in 0..10_000 {
        if step % EVERY == 0 {
            samples.push(state[3] - rest[3]);
        }
        let course = turning * h * f64::from(step);
        let (k1, middle) = (slope(course, state), course + 0.5 * h * turning);
        let k2 = slope(middle, sum(state, k1, 0.5 * h));
        let k3 = slope(middle, sum(state, k2, 0.5 * h));
        let k4 = slope(course + h * turning, sum(state, k3, h));
        for (k, weight) in [(k1, 1.0), (k2, 2.0), (k3, 2.0), (k4, 1.0)] {
            state = sum(state, k, h * weight / 6.0);
        }
    }
    samples
}

/// Every linear combination of four modes satisfies the recurrence whose roots are the factors
/// of the modes from sample to sample.
#[test]
fn disturbances_follow_the_modes_of_the_eigenvalues() {
    for speed in [0.5, 1.0, 1.5, 1.59] {
        let steady = circle(1.0).at_speed(speed).unwrap();
        let mut recurrence = vec![Complex::new(1.0, 0.0)];
        for eigenvalue in steady.eigenvalues() {
            let factor = (eigenvalue * f64::from(EVERY) * STEP).exp();
            let shifted = recurrence.clone();
            recurrence.push(Complex::new(0.0, 0.0));
            for (term, before) in recurrence.iter_mut().skip(1).zip(shifted) {
                *term -= factor * before;
            }
        }
        let samples = simulated_steering(1.0, &steady);
        let mut worst: f64 = 0.0;
        for window in samples.windows(5) {
            let residual: f64 = recurrence
                .iter()
                .zip(window.iter().rev())
                .map(|(factor, sample)| factor.re * sample)
                .sum();
            let size = window
                .iter()
                .fold(0.0_f64, |size, sample| size.max(sample.abs()));
            worst = worst.max(residual.abs() / size);
        }
        println!("{speed}: {worst:e}");
        assert!(worst < 1e-5, "{speed}: {worst:e}");
    }
}

#[test]
fn a_circle_that_is_too_small_is_refused() {
    let error = Circle::new(VehicleParameters::paper(), P, 0.5).unwrap_err();
    assert!(error.to_string().contains("0.5 m is too small"), "{error}");
}
