//! The sampled loop, against the continuous loop and against a simulation with the laws and
//! the model of the car.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use nalgebra::Vector2;
use singletrack_analysis::stability::{
    ClosedLoop, Law, MarginLimits, SampledLoop, Timing, first_unstable_speed, least_point_distance,
};
use singletrack_control::{
    FrontPointLaw, Motion, SingleTrack, SingleTrackDerivative, SingleTrackState, VehicleParameters,
    VelocityPointLaw,
};

const P: f64 = 0.35;
const PERIOD: f64 = 0.01;

fn closed_loop(law: Law, speed: f64, deviation: f64) -> ClosedLoop {
    ClosedLoop::new(VehicleParameters::paper(), law, P, speed, deviation).unwrap()
}

fn sampled(law: Law, speed: f64, deviation: f64, delay: f64) -> SampledLoop {
    timed(law, speed, deviation, Timing::new(PERIOD, delay))
}

fn timed(law: Law, speed: f64, deviation: f64, timing: Timing) -> SampledLoop {
    SampledLoop::new(closed_loop(law, speed, deviation), timing).unwrap()
}

#[test]
fn a_fast_sampled_loop_equals_the_continuous_loop() {
    for law in [Law::FrontPoint, Law::VelocityPoint] {
        for speed in [1.0, 2.0, 5.0] {
            let closed_loop = closed_loop(law, speed, 0.004);
            let period = 1e-5;
            let growth = libm::log(
                SampledLoop::new(closed_loop, Timing::new(period, 0.0))
                    .unwrap()
                    .spectral_radius(),
            ) / period;
            let rightmost = closed_loop.eigenvalues().last().unwrap().re;
            assert!(
                (growth / rightmost - 1.0).abs() < 1e-2,
                "{law:?} {speed}: {growth} {rightmost}"
            );
        }
    }
}

/// The growth of a small disturbance per tick in the long run, from a simulation with the
/// laws and the model of the car.
fn simulated_growth(law: Law, speed: f64, deviation: f64, late: usize, interval: usize) -> f64 {
    let vehicle = VehicleParameters::paper();
    let assumed = vehicle.front_axle_distance_m + deviation;
    let front = FrontPointLaw::new(assumed, P, vehicle.wheelbase_m()).unwrap();
    let velocity = VelocityPointLaw::new(vehicle.with_centre_of_mass_at(assumed), P).unwrap();
    let model = SingleTrack::new(vehicle);
    let wanted = Vector2::new(speed, 0.0);

    let mut state = SingleTrackState {
        yaw: 1e-6,
        ..SingleTrackState::default()
    };
    let mut steering = 0.0;
    let mut seen = state;
    let mut waiting = std::collections::VecDeque::from(vec![[speed, 0.0]; late]);
    let mut sizes = Vec::new();
    let mut grown = 0.0;
    for tick in 0..6000 {
        if tick % interval == 0 {
            seen = state;
        }
        let motion = Motion {
            yaw: seen.yaw,
            yaw_rate: state.yaw_rate,
            sideslip: state.sideslip,
        };
        waiting.push_back(match law {
            Law::FrontPoint => {
                let command = front.command(&motion, steering, &wanted).unwrap();
                [command.speed, command.steering_rate]
            }
            Law::VelocityPoint => {
                let command = velocity.command(&motion, &wanted).unwrap();
                [command.speed, command.steering]
            }
        });
        let [v, input] = waiting.pop_front().unwrap();
        let steps = 20;
        let step = PERIOD / f64::from(steps);
        for _ in 0..steps {
            let slope = |state: &SingleTrackState, steering: f64| {
                let angle = if law == Law::FrontPoint {
                    steering
                } else {
                    input
                };
                model.derivative(state, v, angle)
            };
            let rate = if law == Law::FrontPoint { input } else { 0.0 };
            let moved = |by: f64, slope: &SingleTrackDerivative| SingleTrackState {
                yaw: state.yaw + by * slope.yaw,
                yaw_rate: state.yaw_rate + by * slope.yaw_rate,
                sideslip: state.sideslip + by * slope.sideslip,
                ..state
            };
            let first = slope(&state, steering);
            let second = slope(&moved(0.5 * step, &first), steering + 0.5 * step * rate);
            let third = slope(&moved(0.5 * step, &second), steering + 0.5 * step * rate);
            let fourth = slope(&moved(step, &third), steering + step * rate);
            let mean = SingleTrackDerivative {
                yaw: (first.yaw + 2.0 * (second.yaw + third.yaw) + fourth.yaw) / 6.0,
                yaw_rate: (first.yaw_rate
                    + 2.0 * (second.yaw_rate + third.yaw_rate)
                    + fourth.yaw_rate)
                    / 6.0,
                sideslip: (first.sideslip
                    + 2.0 * (second.sideslip + third.sideslip)
                    + fourth.sideslip)
                    / 6.0,
                ..SingleTrackDerivative::default()
            };
            state = moved(step, &mean);
            steering += step * rate;
        }
        // Scaled down to remain in the linear range.
        let size = state
            .yaw
            .abs()
            .max(state.yaw_rate.abs())
            .max(state.sideslip.abs());
        sizes.push(grown + libm::log(size.max(1e-300)));
        if tick % 500 == 499 && !(1e-9..1e-4).contains(&size) {
            let factor = 1e-6 / size;
            grown -= libm::log(factor);
            for value in [
                &mut state.yaw,
                &mut state.yaw_rate,
                &mut state.sideslip,
                &mut seen.yaw,
                &mut steering,
            ] {
                *value *= factor;
            }
            for [_, input] in &mut waiting {
                *input *= factor;
            }
        }
    }
    // The envelope of an oscillation: the largest values in two windows.
    let largest = |from: usize, to: usize| {
        sizes[from..to]
            .iter()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max)
    };
    libm::exp((largest(5000, 6000) - largest(3000, 4000)) / 2000.0)
}

#[test]
fn the_spectral_radius_equals_the_simulated_growth() {
    for (law, speed, deviation, late, interval) in [
        (Law::FrontPoint, 1.5, 0.0, 1, 1),
        (Law::FrontPoint, 1.5, 0.0, 12, 1),
        (Law::FrontPoint, 2.0, 0.1232, 3, 40),
        (Law::FrontPoint, 3.0, -0.1, 2, 20),
        (Law::VelocityPoint, 2.0, 0.0, 1, 1),
        (Law::VelocityPoint, 2.0, 0.0, 2, 30),
        (Law::VelocityPoint, 2.0, 0.06, 1, 1),
    ] {
        let timing = Timing {
            marker_interval: u32::try_from(interval).unwrap(),
            ..Timing::new(PERIOD, late as f64 * PERIOD)
        };
        let by_matrix = timed(law, speed, deviation, timing).spectral_radius();
        let by_simulation = simulated_growth(law, speed, deviation, late, interval);
        assert!(
            (by_matrix - by_simulation).abs() < 3e-4,
            "{law:?} {speed} {deviation} {late} {interval}: {by_matrix} {by_simulation}"
        );
    }
}

#[test]
fn the_delay_margin_separates_stable_from_unstable_delays() {
    let limits = MarginLimits::default();
    for law in [Law::FrontPoint, Law::VelocityPoint] {
        for speed in [2.0, 4.0] {
            let margin = sampled(law, speed, 0.0, 0.01).delay_margin(limits).unwrap();
            assert!(sampled(law, speed, 0.0, margin - 1e-4).spectral_radius() < 1.0);
            assert!(sampled(law, speed, 0.0, margin + 1e-4).spectral_radius() > 1.0);
        }
    }
}

#[test]
fn the_longest_constant_interval_is_the_last_stable_one() {
    let limits = MarginLimits::default();
    for (law, gain) in [
        (Law::FrontPoint, 0.0),
        (Law::FrontPoint, 1.0),
        (Law::VelocityPoint, 0.0),
    ] {
        let seen_every = |marker_interval: u32| {
            let timing = Timing {
                position_gain: gain,
                marker_interval,
                ..Timing::new(PERIOD, 0.01)
            };
            timed(law, 2.0, 0.0, timing)
        };
        let longest = seen_every(1).longest_constant_interval(limits).unwrap();
        let ticks = (longest / PERIOD).round() as u32;
        assert!(ticks > 10);
        assert!(seen_every(ticks).spectral_radius() < 1.0);
        assert!(seen_every(ticks + 1).spectral_radius() >= 1.0);
    }
}

#[test]
fn the_limits_of_speed_and_of_p_are_those_of_the_marker_interval() {
    for interval in [1, 7, 20, 60] {
        let timing = Timing {
            marker_interval: interval,
            ..Timing::new(PERIOD, 0.01)
        };
        let sampled = timed(Law::FrontPoint, 1.0, 0.0, timing);
        let radius = |speed: f64, distance: f64| {
            let at = closed_loop(Law::FrontPoint, speed, 0.0);
            sampled
                .around(at.with_point_distance(distance).unwrap())
                .spectral_radius()
        };
        if let Some(speed) = first_unstable_speed(&sampled, &[0.0], [0.5, 20.0]).unwrap() {
            assert!(radius(0.99 * speed, P) < 1.0, "{interval}: {speed} m/s");
            assert!(radius(1.01 * speed, P) > 1.0, "{interval}: {speed} m/s");
        }
        if let Some(least) = least_point_distance(&sampled, &[0.0], [0.01, 5.0]).unwrap() {
            assert!(radius(1.0, 1.01 * least) < 1.0, "{interval}: {least} m");
            assert!(radius(1.0, 0.99 * least) > 1.0, "{interval}: {least} m");
        }
    }
}

#[test]
fn a_loop_that_is_unstable_without_delay_has_no_margins() {
    let sampled = sampled(Law::VelocityPoint, 1.0, 0.1, 0.0);
    assert_eq!(sampled.delay_margin(MarginLimits::default()), Some(0.0));
    assert_eq!(
        sampled.longest_constant_interval(MarginLimits::default()),
        Some(0.0)
    );
}

#[test]
fn a_slow_car_is_stable_up_to_the_limits_of_the_search() {
    let sampled = sampled(Law::FrontPoint, 0.1, 0.0, 0.01);
    assert_eq!(sampled.delay_margin(MarginLimits::default()), None);
    assert_eq!(
        sampled.longest_constant_interval(MarginLimits::default()),
        None
    );
}

#[test]
fn invalid_sampling_parameters_are_rejected_by_name() {
    let closed_loop = closed_loop(Law::FrontPoint, 1.0, 0.0);
    let error = SampledLoop::new(closed_loop, Timing::new(0.0, 0.0))
        .unwrap_err()
        .to_string();
    assert_eq!(
        error,
        "the control period in s is 0: it must be finite and above zero"
    );
    assert!(
        SampledLoop::new(closed_loop, Timing::new(0.01, -0.1))
            .unwrap_err()
            .to_string()
            .contains("delay")
    );
    let timing = Timing {
        position_gain: f64::NAN,
        ..Timing::new(0.01, 0.0)
    };
    assert!(
        SampledLoop::new(closed_loop, timing)
            .unwrap_err()
            .to_string()
            .contains("NaN")
    );
}
