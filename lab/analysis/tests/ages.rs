//! The sampled loop with old measurements, predicted poses and the pilot's compensation, against a
//! simulation in steps of a quarter of a millisecond: the equations of the car written out, the
//! signals in ring buffers, and the pilot's own predictor.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_analysis::stability::{
    Ages, ClosedLoop, Compensation, Law, SampledLoop, Servo, Timing,
};
use singletrack_control::statistics::Random;
use singletrack_control::{
    ActuatorModel, Estimate, FrontPointLaw, Motion, Position, Predictor, Time, VehicleParameters,
    Velocity,
};

const STEP: f64 = 0.000_25;
const STEPS_PER_TICK: usize = 40;
const PERIOD: f64 = STEP * STEPS_PER_TICK as f64;
/// Longer than every delay, in steps.
const DEPTH: usize = 512;

/// A point of the comparison; times are in steps.
#[derive(Clone, Copy, Debug)]
struct Point {
    p: f64,
    speed: f64,
    lag: f64,
    delay: usize,
    yaw_rate_age: usize,
    sideslip_age: usize,
    interval: u32,
    predicted: u32,
    frame: usize,
    /// The dead time as the pilot models it.
    compensation: Option<usize>,
}

fn point(random: &mut Random, number: u32) -> Point {
    Point {
        p: random.between(0.05, 0.5),
        speed: random.between(0.5, 6.0),
        lag: random.between(0.01, 0.08),
        delay: random.below(140),
        yaw_rate_age: random.below(120),
        sideslip_age: random.below(2) * random.below(60),
        interval: 1 + number % 25,
        predicted: random.below(4) as u32,
        frame: 1 + random.below(3),
        compensation: (random.below(2) == 1).then(|| random.below(140)),
    }
}

fn model(point: &Point) -> SampledLoop {
    let vehicle = VehicleParameters::paper();
    let seconds = |steps: usize| steps as f64 * STEP;
    let closed_loop = ClosedLoop::new(vehicle, Law::FrontPoint, point.p, point.speed, 0.0).unwrap();
    let servo = Servo {
        lag: point.lag,
        dead_time: 0.0,
    };
    let compensation = point.compensation.map(|dead_time| Compensation {
        servo: Servo {
            dead_time: seconds(dead_time),
            ..servo
        },
        vehicle,
    });
    let timing = Timing {
        servo: Some(servo),
        marker_interval: point.interval,
        predicted_pose: point.predicted,
        servo_frame: u32::try_from(point.frame).unwrap(),
        ages: Ages {
            yaw_rate: seconds(point.yaw_rate_age),
            sideslip: seconds(point.sideslip_age),
        },
        compensation,
        ..Timing::new(PERIOD, seconds(point.delay))
    };
    SampledLoop::new(closed_loop, timing).unwrap()
}

/// The logarithm of the growth per tick, and the number of ticks that it is of.
fn simulated_growth(point: &Point) -> (f64, usize) {
    let vehicle = VehicleParameters::paper();
    let (m, i_z) = (vehicle.mass_kg, vehicle.yaw_inertia_kg_m2);
    let (l_f, l_r) = (vehicle.front_axle_distance_m, vehicle.rear_axle_distance_m);
    let (c_f, c_r) = (
        vehicle.front_cornering_stiffness_n_rad,
        vehicle.rear_cornering_stiffness_n_rad,
    );
    let v = point.speed;
    // Equations 1 and 2 to first order.
    let slope = |[_, r, beta, delta]: [f64; 4], angle: f64| {
        let front = c_f * (delta - beta - l_f * r / v);
        let rear = c_r * (l_r * r / v - beta);
        [
            r,
            (l_f * front - l_r * rear) / i_z,
            (front + rear) / (m * v) - r,
            (angle - delta) / point.lag,
        ]
    };
    let law = FrontPointLaw::new(l_f, point.p, vehicle.wheelbase_m()).unwrap();
    let wanted = Velocity::new(v, 0.0);
    let actuators = ActuatorModel {
        steering_dead_time: point.compensation.unwrap_or(0) as f64 * STEP,
        steering_lag: point.lag,
        speed_dead_time: 0.0,
        speed_lag: 0.0,
    };
    let mut predictor = Predictor::new(actuators, &vehicle);
    let mut state = [1e-6, 1e-6, 0.0, 0.0];
    // The signals of the last steps; index 0 is the present.
    let mut past = std::collections::VecDeque::from(vec![[0.0; 4]; DEPTH]);
    let mut commands = std::collections::VecDeque::from(vec![0.0; DEPTH]);
    let (mut commanded, mut pulse, mut held) = (0.0, 0.0, 0.0);
    let start = 1_000_000_000_000;
    let mut sizes = Vec::new();
    for tick in 0..6_000_usize {
        let now = Time(start + tick as u64 * (PERIOD * 1e9) as u64);
        past[0] = state;
        if tick as u32 % point.interval <= point.predicted {
            held = state[0];
        }
        let mut motion = Motion {
            yaw: held,
            yaw_rate: past[point.yaw_rate_age][1],
            sideslip: past[point.sideslip_age][2],
        };
        if point.compensation.is_some() {
            predictor.advance(now, v);
            let estimate = Estimate {
                time: now,
                position: Position::origin(),
                yaw: motion.yaw,
                yaw_rate: motion.yaw_rate,
                sideslip: motion.sideslip,
                speed: v,
                pose_time: now,
            };
            let seen = predictor.predict(&estimate);
            motion = seen.motion;
            let rate = law.command(&motion, seen.wheels, &wanted).unwrap();
            commanded = predictor.command_for(seen.wheels, rate.steering_rate, PERIOD);
            predictor.commanded(now, commanded);
        } else {
            let rate = law.command(&motion, commanded, &wanted).unwrap();
            commanded += rate.steering_rate * PERIOD;
        }
        if tick.is_multiple_of(point.frame) {
            pulse = commanded;
        }
        for _ in 0..STEPS_PER_TICK {
            commands.pop_back();
            commands.push_front(pulse);
            let angle = commands[point.delay];
            let moved = |by: f64, slope: [f64; 4]| {
                let mut state = state;
                for (value, slope) in state.iter_mut().zip(slope) {
                    *value += by * slope;
                }
                state
            };
            let one = slope(state, angle);
            let two = slope(moved(0.5 * STEP, one), angle);
            let three = slope(moved(0.5 * STEP, two), angle);
            let four = slope(moved(STEP, three), angle);
            state = moved(
                STEP / 6.0,
                [0, 1, 2, 3].map(|i| one[i] + 2.0 * (two[i] + three[i]) + four[i]),
            );
            past.pop_back();
            past.push_front(state);
        }
        let size = state.iter().fold(0.0_f64, |size, x| size.max(x.abs()));
        sizes.push(libm::log(size));
        // Neither rounding nor the sines of the predictor count in between.
        if !(1e-14..1e-2).contains(&size) {
            break;
        }
    }
    // The envelope of an oscillation: the largest values of two windows.
    let all = sizes.len();
    let peak = |from: usize, to: usize| {
        sizes[from..to]
            .iter()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max)
    };
    let window = all / 4;
    let between = all - window - all / 3;
    let growth = peak(all - window, all) - peak(all / 3, all / 3 + window);
    (growth / between as f64, between)
}

#[test]
fn the_spectral_radius_equals_the_growth_at_a_hundred_random_points() {
    let mut random = Random::new(20_261_127);
    let (mut compensated, mut unstable) = (0, 0);
    for number in 0..100 {
        let point = point(&mut random, number);
        let by_matrix = libm::log(model(&point).spectral_radius());
        let (by_simulation, ticks) = simulated_growth(&point);
        let tolerance = 1e-3 + 2.0 / ticks as f64;
        println!("{by_matrix:9.5} {by_simulation:9.5} {ticks:5} {point:?}");
        assert!(
            (by_matrix - by_simulation).abs() < tolerance,
            "{point:?}: {by_matrix} {by_simulation} {ticks}"
        );
        compensated += u32::from(point.compensation.is_some());
        unstable += u32::from(by_matrix > 0.0);
    }
    assert!((30..70).contains(&compensated) && (20..80).contains(&unstable));
}
