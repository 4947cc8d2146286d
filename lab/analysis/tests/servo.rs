//! The sampled loop with a steering servo and with a controller that predicts, against two
//! computations of its own kind: the characteristic function of the continuous delay system,
//! and a simulation with the law and the model of the car.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use std::{collections::VecDeque, f64::consts::PI};

use nalgebra::{Complex, Vector2};
use singletrack_analysis::stability::{
    ClosedLoop, Law, MarginLimits, Prediction, SampledLoop, Servo, Timing, first_unstable_speed,
    least_point_distance,
};
use singletrack_control::{
    FrontPointLaw, Motion, SingleTrack, SingleTrackState, VehicleParameters,
};

/// The simulated car's: 6 ms from a tick to the pulse, and 12 ms of dead time.
const SERVO: Servo = Servo {
    lag: 0.04,
    dead_time: 0.012,
};
const DELAY: f64 = 0.006;
const SPEEDS: [f64; 2] = [0.1, 20.0];

fn closed_loop(p: f64, speed: f64, deviation: f64) -> ClosedLoop {
    ClosedLoop::new(
        VehicleParameters::paper(),
        Law::FrontPoint,
        p,
        speed,
        deviation,
    )
    .unwrap()
}

const fn timing(gain: f64) -> Timing {
    Timing {
        servo: Some(SERVO),
        position_gain: gain,
        ..Timing::new(0.01, DELAY)
    }
}

fn on_the_car(p: f64, speed: f64, gain: f64) -> SampledLoop {
    SampledLoop::new(closed_loop(p, speed, 0.0), timing(gain)).unwrap()
}

fn exact_prediction() -> Option<Prediction> {
    timing(0.0).exact_prediction(VehicleParameters::paper())
}

fn with_prediction(p: f64, speed: f64, gain: f64, prediction: Prediction) -> SampledLoop {
    let timing = Timing {
        prediction: Some(prediction),
        ..timing(gain)
    };
    SampledLoop::new(closed_loop(p, speed, 0.0), timing).unwrap()
}

/// The delay at which the continuous loop with the lag of a servo loses its stability, by the
/// frequency response of the loop cut at the command: where its magnitude is one, the delay
/// turns its phase to zero.
///
/// Written down from equations 1, 2 and 8, with Cramer's rule in place of a state space.
fn continuous_delay_margin(p: f64, v: f64, deviation: f64, gain: f64, lag: f64) -> f64 {
    let car = VehicleParameters::paper();
    let (m, i_z) = (car.mass_kg, car.yaw_inertia_kg_m2);
    let (l_f, l_r) = (car.front_axle_distance_m, car.rear_axle_distance_m);
    let (c_f, c_r) = (
        car.front_cornering_stiffness_n_rad,
        car.rear_cornering_stiffness_n_rad,
    );
    let assumed = l_f + deviation;
    let response = |omega: f64| {
        let s = Complex::new(0.0, omega);
        // (s - a11) r - a12 β = b1 δ and -a21 r + (s - a22) β = b2 δ.
        let a11 = -(c_f * l_f * l_f + c_r * l_r * l_r) / (i_z * v);
        let a12 = (c_r * l_r - c_f * l_f) / i_z;
        let a21 = (c_r * l_r - c_f * l_f) / (m * v * v) - 1.0;
        let a22 = -(c_f + c_r) / (m * v);
        let (b1, b2) = (c_f * l_f / i_z, c_f / (m * v));
        let determinant = (s - a11) * (s - a22) - a12 * a21;
        let r = ((s - a22) * b1 + a12 * b2) / determinant;
        let beta = ((s - a11) * b2 + a21 * b1) / determinant;
        let psi = r / s;
        let y = (psi + beta) * v / s;
        let wheels = (s * lag + 1.0).inv();
        // The rate by the state over the wheels' angle, and by the commanded angle itself.
        let v_py = -(y + psi * (assumed + p)) * gain;
        let rate = (v_py - (psi + beta) * v - r * assumed) / p - r;
        rate * wheels / (s + gain)
    };
    // The smallest delay over all crossings of the magnitude.
    let mut margin = f64::INFINITY;
    let (from, to, steps) = (1e-3_f64, 1e3_f64, 20_000);
    let at = |step: i32| from * (to / from).powf(f64::from(step) / f64::from(steps));
    for step in 0..steps {
        let (mut low, mut high) = (at(step), at(step + 1));
        let above = |omega: f64| response(omega).norm() > 1.0;
        if above(low) == above(high) {
            continue;
        }
        let rising = above(high);
        while high - low > 1e-13 * high {
            let middle = 0.5 * (low + high);
            if above(middle) == rising {
                high = middle;
            } else {
                low = middle;
            }
        }
        let phase = response(low).arg();
        let phase = if phase < 0.0 { phase + 2.0 * PI } else { phase };
        margin = margin.min(phase / low);
    }
    margin
}

#[test]
fn the_delay_margin_tends_to_that_of_the_continuous_delay_system() {
    for (p, speed, deviation, gain) in [
        (0.35, 2.0, 0.0, 0.0),
        (0.35, 3.5, 0.0, 1.0),
        (0.35, 2.0, -0.1, 1.0),
        (0.2, 1.5, 0.1, 2.0),
        (0.1, 1.0, 0.0, 1.0),
    ] {
        let expected = continuous_delay_margin(p, speed, deviation, gain, SERVO.lag);
        let at = |period: f64| {
            let timing = Timing {
                servo: Some(Servo {
                    dead_time: 0.0,
                    ..SERVO
                }),
                position_gain: gain,
                ..Timing::new(period, 0.0)
            };
            SampledLoop::new(closed_loop(p, speed, deviation), timing)
                .unwrap()
                .delay_margin(MarginLimits::default())
                .unwrap()
        };
        let (coarse, fine) = (at(0.004) - expected, at(0.002) - expected);
        println!("{p} {speed} {deviation} {gain}: {expected} s, {coarse:e} {fine:e}");
        // The angle of a tick is sent at once and held: late by the position gain alone, and in
        // proportion to the period. The limit for no period, to the resolution of the search:
        let limit = 2.0 * fine - coarse;
        assert!(limit.abs() < 3e-6, "{expected}: {coarse} {fine}");
        assert!(fine.abs() < 0.1 * 0.002, "{expected}: {fine}");
    }
}

/// What the law is given.
#[derive(Clone, Copy, Debug)]
enum Seen {
    /// The state at the tick.
    AtTheTick,
    /// The state at which the command acts.
    Predicted(Prediction),
    /// The state at the tick, with a yaw that the yaw rate has turned for a time in s.
    YawAhead(f64),
}

/// The growth per tick of a small disturbance, from a simulation of the law, the model of the
/// car, the servo, and a controller that integrates its models ahead.
fn simulated_growth(p: f64, speed: f64, seen: Seen) -> f64 {
    const STEPS_PER_TICK: usize = 100;
    const STEP: f64 = 0.01 / STEPS_PER_TICK as f64;
    let vehicle = VehicleParameters::paper();
    let law = FrontPointLaw::new(vehicle.front_axle_distance_m, p, vehicle.wheelbase_m()).unwrap();
    let wanted = Vector2::new(speed, 0.0);
    let prediction = match seen {
        Seen::Predicted(prediction) => Some(prediction),
        _ => None,
    };
    // State: yaw, yaw rate, sideslip, wheels.
    let advanced = |model: &SingleTrack, [yaw, r, beta, wheels]: [f64; 4], lag: f64, angle: f64| {
        let rate = |yaw: f64, r: f64, beta: f64, wheels: f64| {
            let slope = model.derivative(
                &SingleTrackState {
                    yaw,
                    yaw_rate: r,
                    sideslip: beta,
                    ..SingleTrackState::default()
                },
                speed,
                wheels,
            );
            [
                slope.yaw,
                slope.yaw_rate,
                slope.sideslip,
                (angle - wheels) / lag,
            ]
        };
        let one = rate(yaw, r, beta, wheels);
        let half = 0.5 * STEP;
        let two = rate(
            yaw + half * one[0],
            r + half * one[1],
            beta + half * one[2],
            wheels + half * one[3],
        );
        [
            yaw + STEP * two[0],
            r + STEP * two[1],
            beta + STEP * two[2],
            wheels + STEP * two[3],
        ]
    };
    let steps_of = |time: f64| (time / STEP).round() as usize;
    let true_delay = steps_of(DELAY + SERVO.dead_time);
    let model = SingleTrack::new(vehicle);
    let mut state = [1e-6, 0.0, 0.0, 0.0];
    let mut modelled = 0.0;
    let mut commanded = 0.0;
    // The command at each step, from the oldest; the wheels get the one `delay` ago.
    let depth = 400;
    let mut commands: VecDeque<f64> = vec![0.0; depth].into();
    let (mut sizes, mut grown) = (Vec::new(), 0.0);
    for _ in 0..3_000 {
        let seen = match &seen {
            Seen::AtTheTick => state,
            Seen::YawAhead(time) => {
                let [yaw, yaw_rate, sideslip, wheels] = state;
                [yaw + time * yaw_rate, yaw_rate, sideslip, wheels]
            }
            Seen::Predicted(prediction) => {
                let model = SingleTrack::new(prediction.vehicle);
                let delay = steps_of(prediction.delay);
                let mut ahead = [state[0], state[1], state[2], modelled];
                for step in 0..steps_of(prediction.horizon()) {
                    // Under way, and then the newest.
                    let angle = if step < delay {
                        commands[depth - delay + step]
                    } else {
                        commanded
                    };
                    ahead = advanced(&model, ahead, prediction.lag, angle);
                }
                ahead
            }
        };
        let motion = Motion {
            yaw: seen[0],
            yaw_rate: seen[1],
            sideslip: seen[2],
        };
        let angle = if prediction.is_some() {
            seen[3]
        } else {
            commanded
        };
        commanded += 0.01 * law.command(&motion, angle, &wanted).unwrap().steering_rate;
        for _ in 0..STEPS_PER_TICK {
            commands.push_back(commanded);
            commands.pop_front();
            state = advanced(&model, state, SERVO.lag, commands[depth - 1 - true_delay]);
            if let Some(prediction) = &prediction {
                let angle = commands[depth - 1 - steps_of(prediction.delay)];
                let follows = 1.0 - libm::exp(-STEP / prediction.lag);
                modelled += follows * (angle - modelled);
            }
        }
        let size = state.iter().fold(0.0_f64, |size, x| size.max(x.abs()));
        sizes.push(grown + libm::log(size));
        if !(1e-9..1e-4).contains(&size) {
            let factor = 1e-6 / size;
            grown -= libm::log(factor);
            state.iter_mut().for_each(|x| *x *= factor);
            commands.iter_mut().for_each(|x| *x *= factor);
            commanded *= factor;
            modelled *= factor;
        }
    }
    // The largest size of each of two late windows: oscillations are seen at their peaks.
    let peak = |window: std::ops::Range<usize>| {
        sizes[window]
            .iter()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max)
    };
    libm::exp((peak(2_500..3_000) - peak(1_000..1_500)) / 1_500.0)
}

#[test]
fn the_spectral_radius_with_servo_and_prediction_equals_the_simulated_growth() {
    let vehicle = VehicleParameters::paper();
    let wrong = Prediction {
        lag: 0.03,
        delay: 0.025,
        vehicle: VehicleParameters {
            front_cornering_stiffness_n_rad: 0.8 * vehicle.front_cornering_stiffness_n_rad,
            ..vehicle
        },
    };
    for (p, speed) in [(0.35, 1.0), (0.35, 3.0), (0.1, 2.0), (0.03, 1.0)] {
        let plain = on_the_car(p, speed, 0.0);
        let exact = exact_prediction();
        for prediction in [None, exact, Some(wrong)] {
            let sampled = match prediction {
                None => plain,
                Some(prediction) => with_prediction(p, speed, 0.0, prediction),
            };
            let by_matrix = sampled.spectral_radius();
            let seen = prediction.map_or(Seen::AtTheTick, Seen::Predicted);
            let by_simulation = simulated_growth(p, speed, seen);
            println!("{p} {speed}: {by_matrix} {by_simulation}");
            assert!(
                (by_matrix - by_simulation).abs() < 5e-4,
                "{p} {speed} {prediction:?}: {by_matrix} {by_simulation}"
            );
        }
    }
}

#[test]
fn with_the_simulated_servo_each_p_has_a_first_unstable_speed() {
    for (p, expected) in [
        (0.03, 0.910),
        (0.05, 1.249),
        (0.1, 1.840),
        (0.2, 2.666),
        (0.35, 3.822),
    ] {
        let sampled = on_the_car(p, 1.0, 1.0);
        let first = first_unstable_speed(&sampled, &[0.0], SPEEDS).unwrap();
        println!("{p}: {first:?}");
        assert!((first.unwrap() - expected).abs() < 1e-3, "{p}: {first:?}");
    }
}

#[test]
fn an_exact_prediction_removes_the_first_unstable_speed() {
    for p in [0.03, 0.05, 0.1, 0.2, 0.35] {
        for gain in [0.0, 1.0, 2.0] {
            let sampled = with_prediction(p, 1.0, gain, exact_prediction().unwrap());
            let first = first_unstable_speed(&sampled, &[0.0], SPEEDS).unwrap();
            println!("{p} {gain}: {first:?}");
            assert_eq!(first, None, "{p} {gain}");
        }
    }
}

#[test]
fn a_prediction_of_the_yaw_alone_costs_stability() {
    // Without a prediction the first unstable speed is 3.83 m/s.
    let speed = 3.7;
    let plain = simulated_growth(0.35, speed, Seen::AtTheTick);
    let horizon = SERVO.lag + SERVO.dead_time + DELAY;
    let ahead = simulated_growth(0.35, speed, Seen::YawAhead(horizon));
    println!("{plain} {ahead}");
    assert!(plain < 0.999_5 && ahead > 1.000_5, "{plain} {ahead}");
}

/// Makes a part of a prediction wrong by a factor.
type Wrong = fn(&mut Prediction, f64);

/// The least first unstable speed over predictions with `part` wrong by ±20 %.
fn with_wrong(p: f64, wrong: Wrong) -> Option<f64> {
    [0.8, 1.2]
        .into_iter()
        .filter_map(|factor| {
            let mut prediction = exact_prediction().unwrap();
            wrong(&mut prediction, factor);
            let sampled = with_prediction(p, 1.0, 1.0, prediction);
            first_unstable_speed(&sampled, &[0.0], SPEEDS).unwrap()
        })
        .reduce(f64::min)
}

#[test]
fn the_least_p_grows_with_the_speed_and_the_delay() {
    let distances = [0.01, 2.0];
    let least = |speed: f64, delay: f64| {
        let timing = Timing {
            delay,
            ..timing(0.0)
        };
        let sampled = SampledLoop::new(closed_loop(0.35, speed, 0.0), timing).unwrap();
        least_point_distance(&sampled, &[0.0], distances)
            .unwrap()
            .unwrap()
    };
    let mut last = 0.0;
    for speed in [0.5, 1.0, 1.5, 2.0, 3.0] {
        let [now, later] = [0.006, 0.016].map(|delay| least(speed, delay));
        println!("{speed}: {now} {later}");
        assert!(now > last && later > now, "{speed}: {now} {later}");
        last = now;
        // It is the other side of the first unstable speed.
        let at = on_the_car(now, 1.0, 0.0);
        let first = first_unstable_speed(&at, &[0.0], SPEEDS).unwrap().unwrap();
        assert!((first / speed - 1.0).abs() < 1e-4, "{speed}: {first}");
    }
}

#[test]
fn an_invalid_servo_is_rejected_by_name() {
    let error = |servo| {
        let timing = Timing {
            servo: Some(servo),
            ..Timing::new(0.01, 0.01)
        };
        let refused = SampledLoop::new(closed_loop(0.35, 1.0, 0.0), timing);
        refused.unwrap_err().to_string()
    };
    assert!(error(Servo { lag: 0.0, ..SERVO }).contains("lag of the servo"));
    let negative = Servo {
        dead_time: -1.0,
        ..SERVO
    };
    assert!(error(negative).contains("dead time of the servo"));
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn a_prediction_by_models_that_are_a_fifth_wrong_still_helps() {
        let kinds: [(&str, Wrong); 5] = [
            ("lag", |prediction, factor| prediction.lag *= factor),
            ("delay", |prediction, factor| prediction.delay *= factor),
            ("C_f", |prediction, factor| {
                prediction.vehicle.front_cornering_stiffness_n_rad *= factor;
            }),
            ("C_r", |prediction, factor| {
                prediction.vehicle.rear_cornering_stiffness_n_rad *= factor;
            }),
            ("I_z", |prediction, factor| {
                prediction.vehicle.yaw_inertia_kg_m2 *= factor;
            }),
        ];
        for p in [0.03, 0.05, 0.1, 0.2, 0.35] {
            let plain = first_unstable_speed(&on_the_car(p, 1.0, 1.0), &[0.0], SPEEDS)
                .unwrap()
                .unwrap();
            for (name, wrong) in kinds {
                let speed = with_wrong(p, wrong);
                println!("{p} m, {name}: {speed:.2?} instead of {plain:.2}");
                assert!(speed.is_none_or(|speed| speed > 1.5 * plain), "{p} {name}");
            }
        }
    }
}
