//! Any point of the car's axis will do in place of the centre of mass, if pose, sideslip and
//! `l_f` all refer to it: the law is kinematics of that point.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_control::{
    FrontPointLaw, Motion, Position, SingleTrack, SingleTrackState, VehicleParameters, Velocity,
    direction, front_point,
};

const P: f64 = 0.35;
const STEP: f64 = 2.5e-4;

/// What the controller takes for the sideslip.
#[derive(Clone, Copy, PartialEq)]
enum Sideslip {
    /// That of the point to which pose and `l_f` refer.
    OfThePoint,
    /// That of the centre of mass.
    OfTheCentreOfMass,
}

/// The velocity of P at a time, in m/s: three turns of 60 degrees, open loop.
fn wanted(time: f64) -> Velocity {
    let turns = (time / 3.0).floor().min(3.0);
    0.6 * direction(turns * core::f64::consts::FRAC_PI_3)
}

/// The largest deviation of the true P from the integral of its wanted velocity, in m, on the
/// paper's model. The controller measures a point `ahead` m ahead of the centre of mass.
fn largest_deviation(ahead: f64, sideslip: Sideslip) -> f64 {
    let vehicle = VehicleParameters::paper();
    let l_f = vehicle.front_axle_distance_m;
    let law = FrontPointLaw::new(l_f - ahead, P, vehicle.wheelbase_m()).unwrap();
    let model = SingleTrack::new(vehicle);
    // The car's motion and the steering, at a speed that the law commands.
    let slope = |[x, y, yaw, r, beta, steering]: [f64; 6], time: f64| {
        let velocity = wanted(time);
        let mut speed = velocity.norm();
        let mut steering_rate = 0.0;
        // The sideslip of the point depends on the speed, and this on the sideslip.
        for _ in 0..60 {
            let forward = speed * beta.cos();
            let seen = match sideslip {
                Sideslip::OfThePoint => (speed * beta.sin() + ahead * r).atan2(forward),
                Sideslip::OfTheCentreOfMass => beta,
            };
            let motion = Motion {
                yaw,
                yaw_rate: r,
                sideslip: seen,
            };
            let command = law.command(&motion, steering, &velocity).unwrap();
            steering_rate = command.steering_rate;
            // The motor drives the rear wheels, whose speed is the forward component of
            // every point of the axis.
            let next = command.speed * seen.cos() / beta.cos();
            let change = (next - speed).abs();
            speed = next;
            if change < 1e-15 {
                break;
            }
        }
        let state = SingleTrackState {
            x,
            y,
            yaw,
            yaw_rate: r,
            sideslip: beta,
        };
        let rate = model.derivative(&state, speed, steering);
        [
            rate.x,
            rate.y,
            rate.yaw,
            rate.yaw_rate,
            rate.sideslip,
            steering_rate,
        ]
    };
    let sum = |a: [f64; 6], b: [f64; 6], by: f64| {
        let mut sum = a;
        sum.iter_mut().zip(b).for_each(|(x, s)| *x += by * s);
        sum
    };
    let point = |[x, y, yaw, .., steering]: [f64; 6]| {
        front_point(Position::new(x, y), yaw, steering, l_f, P)
    };
    let mut state = [0.0; 6];
    let start = point(state);
    let mut nominal = start;
    let mut largest: f64 = 0.0;
    for step in 0..48_000 {
        let time = f64::from(step) * STEP;
        // The wanted velocity is constant within a step.
        let inside = time + 0.5 * STEP;
        let k1 = slope(state, inside);
        let k2 = slope(sum(state, k1, 0.5 * STEP), inside);
        let k3 = slope(sum(state, k2, 0.5 * STEP), inside);
        let k4 = slope(sum(state, k3, STEP), inside);
        for (k, weight) in [(k1, 1.0), (k2, 2.0), (k3, 2.0), (k4, 1.0)] {
            state = sum(state, k, STEP * weight / 6.0);
        }
        nominal += wanted(inside) * STEP;
        let now = point(state);
        largest = largest.max((now - nominal).norm());
    }
    largest
}

#[test]
fn pose_sideslip_and_l_f_may_refer_to_any_point_of_the_axis() {
    let vehicle = VehicleParameters::paper();
    for ahead in [
        -vehicle.rear_axle_distance_m,
        -0.08,
        0.0,
        0.05,
        vehicle.front_axle_distance_m,
    ] {
        let consistent = largest_deviation(ahead, Sideslip::OfThePoint);
        println!("{ahead}: {consistent:e}");
        assert!(consistent < 1e-9, "{ahead}: {consistent}");
    }
}

#[test]
fn a_sideslip_of_another_point_than_l_f_costs_twice_their_distance() {
    for ahead in [-0.095, 0.095] {
        let mixed = largest_deviation(ahead, Sideslip::OfTheCentreOfMass);
        println!("{ahead}: {mixed}");
        // 2 |dl sin(Δψ/2)| after half a turn.
        assert!((mixed - 0.19).abs() < 0.01, "{ahead}: {mixed}");
    }
}
