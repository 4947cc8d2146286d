//! Live tuning: what takes effect, when, and what never does.

#![allow(
    clippy::unwrap_used,
    reason = "the helpers of tests may fail as tests do"
)]

use crate::bench::{Bench, config, square};
use proptest::prelude::*;
use singletrack_control::{
    Circle, Limits, Position, ProportionalLoop, Reference, TrackingLoop, Velocity,
};
use singletrack_pilot::{
    Arming, Event, Mode, Output, POINT_DISTANCE_RATE, PilotConfig, PilotRequest, Tuning,
    TuningBounds,
};

const PERIOD: f64 = 0.01;
const GAIN: [f64; 2] = [0.25, 4.0];
const DISTANCE: [f64; 2] = [0.25, 0.5];

const BOUNDS: TuningBounds = TuningBounds {
    gain: Some(GAIN),
    point_distance: Some(DISTANCE),
};

/// A circle on which P of the bench's car begins a drive.
fn tunable(tuning: Option<TuningBounds>) -> PilotConfig {
    PilotConfig {
        reference: Reference::Circle(Circle::new(Position::new(0.48, 1.5), 1.5, 0.3).unwrap()),
        tuning,
        ..config()
    }
}

fn gain(gain: f64) -> Tuning {
    Tuning {
        gain: Some(Velocity::new(gain, gain)),
        point_distance: None,
    }
}

const fn distance(distance: f64) -> Tuning {
    Tuning {
        gain: None,
        point_distance: Some(distance),
    }
}

fn drive(config: PilotConfig) -> Bench {
    let mut bench = Bench::with(config);
    bench.run(100);
    bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    // P has come to its reference by then.
    assert_eq!(bench.run(1_000).mode, Mode::Driving);
    bench
}

fn tune(bench: &mut Bench, tuning: Tuning) -> Output {
    bench.extra.push(Event::Tuning(tuning));
    bench.step()
}

/// The error of P, and the velocity that corrects it, without the reference's.
fn correction(output: &Output) -> (Velocity, Velocity) {
    let reference = output.reference.unwrap();
    let error = reference.position.unwrap() - output.point.unwrap();
    (error, output.point_velocity.unwrap() - reference.velocity)
}

#[test]
fn a_gain_acts_in_the_tick_in_which_it_comes() {
    let mut bench = drive(tunable(Some(BOUNDS)));
    // Not at once: a jump of the poses counts less than they do.
    for _ in 0..30 {
        bench.position += Velocity::new(1.5e-3, 1.5e-3);
        bench.step();
    }
    let (error, corrects) = correction(&bench.step());
    assert!((corrects - error).norm() < 1e-12, "{corrects} of {error}");
    let output = tune(&mut bench, gain(2.0));
    let (error, corrects) = correction(&output);
    assert!(error.norm() > 0.01);
    assert!(
        (corrects - 2.0 * error).norm() < 1e-12,
        "{corrects} of {error}"
    );
    assert_eq!(output.tuned.unwrap().gain, gain(2.0).gain);
}

#[test]
fn p_goes_to_its_new_value_with_its_rate_and_the_error_does_not_jump() {
    let mut bench = drive(tunable(Some(BOUNDS)));
    let mut last = bench.step();
    let mut output = tune(&mut bench, distance(0.4));
    let mut ticks = 0;
    let step = POINT_DISTANCE_RATE * PERIOD;
    loop {
        let (was, is) = (last.tuned.unwrap(), output.tuned.unwrap());
        assert_eq!(is.wanted_point_distance, 0.4);
        let change = is.point_distance - was.point_distance;
        assert!(change > 0.0 && change <= step * (1.0 + 1e-9), "{change}");
        let jump = (correction(&output).0 - correction(&last).0).norm();
        assert!(jump < 2.0 * step, "{jump}");
        ticks += 1;
        if is.point_distance == 0.4 {
            break;
        }
        last = output;
        output = bench.step();
    }
    assert_eq!(ticks, 100, "0.05 m at 0.05 m/s");
    let tuned = bench.run(500);
    assert_eq!(tuned.tuned.unwrap().point_distance, 0.4);
    assert!(
        correction(&tuned).0.norm() < 0.01,
        "P follows with the new p"
    );
}

#[test]
fn what_the_bounds_do_not_allow_has_no_effect_and_neither_has_its_rest() {
    for refused in [
        gain(4.1),
        gain(0.2),
        gain(f64::NAN),
        gain(-1.0),
        distance(0.51),
        distance(f64::NAN),
        distance(f64::INFINITY),
        Tuning {
            gain: gain(2.0).gain,
            point_distance: Some(0.6),
        },
    ] {
        let mut tuned = drive(tunable(Some(BOUNDS)));
        let mut left = drive(tunable(Some(BOUNDS)));
        assert_eq!(tune(&mut tuned, refused), left.step(), "{refused:?}");
        assert_eq!(tuned.run(100), left.run(100), "{refused:?}");
    }
}

#[test]
fn without_tuning_the_same_requests_change_no_bit() {
    let mut tuned = drive(tunable(None));
    let mut left = drive(tunable(None));
    for tuning in [gain(2.0), distance(0.4)] {
        let output = tune(&mut tuned, tuning);
        assert_eq!(output.tuned, None);
        assert_eq!(output, left.step());
    }
    assert_eq!(tuned.run(100), left.run(100));
}

#[test]
fn a_pilot_that_could_be_tuned_and_is_not_drives_to_the_bit_as_one_that_could_not() {
    let mut tunable_one = drive(tunable(Some(BOUNDS)));
    let mut plain = drive(tunable(None));
    for _ in 0..300 {
        let output = Output {
            tuned: None,
            ..tunable_one.step()
        };
        assert_eq!(output, plain.step());
    }
}

#[test]
fn tuned_values_last_from_drive_to_drive() {
    let mut bench = drive(tunable(Some(BOUNDS)));
    tune(&mut bench, gain(2.0));
    tune(&mut bench, distance(0.36));
    bench.step_with(Some(PilotRequest::Disarm));
    bench.run_until_idle();
    bench.run(200);
    bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    let tuned = bench.run(20).tuned.unwrap();
    assert_eq!(tuned.gain, gain(2.0).gain);
    assert_eq!(tuned.point_distance, 0.36);
}

#[test]
fn another_configuration_keeps_a_tuned_value_unless_it_has_its_own() {
    let mut bench = Bench::with(tunable(Some(BOUNDS)));
    bench.run(100);
    tune(&mut bench, gain(2.0));
    tune(&mut bench, distance(0.4));
    // Another reference: both stay, and p is there at once.
    let other = PilotConfig {
        reference: Reference::Circle(Circle::new(Position::origin(), 1.2, 0.3).unwrap()),
        ..tunable(Some(BOUNDS))
    };
    bench.pilot.reconfigure(&other).unwrap();
    let tuned = bench.pilot.tuned().unwrap();
    assert_eq!((tuned.gain, tuned.point_distance), (gain(2.0).gain, 0.4));
    // Another gain: p stays.
    let configured = Velocity::new(1.5, 1.5);
    let other = PilotConfig {
        tracking: TrackingLoop::Proportional(ProportionalLoop {
            gain: configured,
            feed_forward: true,
        }),
        ..other
    };
    bench.pilot.reconfigure(&other).unwrap();
    let tuned = bench.pilot.tuned().unwrap();
    assert_eq!((tuned.gain, tuned.point_distance), (Some(configured), 0.4));
    // Other bounds of p: it is as configured.
    let other = PilotConfig {
        tuning: Some(TuningBounds {
            point_distance: Some([0.3, 0.45]),
            ..BOUNDS
        }),
        ..other
    };
    bench.pilot.reconfigure(&other).unwrap();
    let tuned = bench.pilot.tuned().unwrap();
    assert_eq!(tuned.point_distance, 0.35);
    assert_eq!(tuned.wanted_point_distance, 0.35);
    let off = PilotConfig {
        tuning: None,
        ..other
    };
    bench.pilot.reconfigure(&off).unwrap();
    assert_eq!(bench.pilot.tuned(), None);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Whatever is tuned and when: speed, acceleration and steering keep their limits, p keeps
    /// its bounds and its rate, and the car stays inside its geofence.
    #[test]
    fn no_tuning_breaks_a_limit(
        tunings in prop::collection::vec(
            (1_u32..60, prop::option::of(GAIN[0]..=GAIN[1]), prop::option::of(GAIN[0]..=GAIN[1]),
             prop::option::of(DISTANCE[0]..=DISTANCE[1])),
            1..12,
        ),
        away in (-0.3..0.3, -0.3..0.3),
    ) {
        let limits = Limits::paper();
        let fence = square(Position::new(0.5, 1.5), 4.2, 0.1);
        let mut bench = Bench::with(PilotConfig { fence: fence.clone(), ..tunable(Some(BOUNDS)) });
        bench.run(100);
        bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
        let mut last = bench.run(100);
        // P is beside its reference, so that the gains matter.
        bench.position += Velocity::new(away.0, away.1) * 0.1;
        for (ticks, x, y, distance) in tunings {
            let gain = x.zip(y).map(|(x, y)| Velocity::new(x, y));
            bench.extra.push(Event::Tuning(Tuning { gain, point_distance: distance }));
            for _ in 0..ticks {
                let output = bench.step();
                let (was, is) = (last.tuned.unwrap(), output.tuned.unwrap());
                let moved = (is.point_distance - was.point_distance).abs();
                prop_assert!(moved <= POINT_DISTANCE_RATE * PERIOD * (1.0 + 1e-9));
                prop_assert!((DISTANCE[0]..=DISTANCE[1]).contains(&is.point_distance));
                let [before, now] = [last.actuation, output.actuation];
                prop_assert!(now.speed <= limits.max_speed && now.speed >= 0.0);
                prop_assert!(now.steering.abs() <= limits.max_steering + 1e-12);
                prop_assert!(
                    (now.steering - before.steering).abs()
                        <= limits.max_steering_rate * PERIOD + 1e-9
                );
                if output.mode == Mode::Driving && last.mode == Mode::Driving {
                    prop_assert!(
                        (now.speed - before.speed).abs() <= limits.max_acceleration * PERIOD + 1e-9
                    );
                }
                let position = output.estimate.unwrap().position;
                prop_assert!(fence.contains_way(&position, &Velocity::zeros()), "{position}");
                last = output;
            }
        }
    }
}
