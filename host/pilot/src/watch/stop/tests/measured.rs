//! What a stop measures of the car's deceleration, and what is relied on.

use super::*;

#[test]
fn a_car_that_rolls_well_obeys_and_its_weak_deceleration_refuses_the_next_drive() {
    let mut watch = StopWatch::default();
    let (alarm, measured) = stop(&mut watch, 1.0, |speed| 0.3 + 0.2 * speed, all);
    assert_eq!(alarm, None);
    let measured = measured.unwrap();
    assert!((0.3..0.5).contains(&measured), "{measured}");
    assert!(watch.is_too_weak(LIMITS.braking));
    assert_eq!(watch.lowest(), measured);
    // A lower belief, which the stop supports, allows to drive; a higher one does not.
    assert!(!watch.is_too_weak(measured));
    assert!(watch.is_too_weak(2.0));
}

#[test]
fn a_motor_that_follows_the_ramp_does_not_hide_a_weak_roll_out() {
    let mut watch = StopWatch::default();
    // The motor follows the ramp of 2.4 m/s² down to 0.5 m/s, and rolls from there.
    let (alarm, measured) = stop(
        &mut watch,
        1.0,
        |speed| if speed > 0.5 { 2.4 } else { 0.6 },
        all,
    );
    assert_eq!(alarm, None);
    assert!((0.5..0.8).contains(&measured.unwrap()), "{measured:?}");
    assert!(watch.is_too_weak(LIMITS.braking));
}

#[test]
fn one_stop_a_little_too_weak_is_a_warning_and_the_second_refuses() {
    let mut watch = StopWatch::default();
    let (_, measured) = stop(&mut watch, 0.8, |_| 1.0, all);
    assert!((0.95..1.2).contains(&measured.unwrap()), "{measured:?}");
    assert!(!watch.is_too_weak(LIMITS.braking));
    stop(&mut watch, 0.8, |_| 1.0, all);
    assert!(watch.is_too_weak(LIMITS.braking));

    let mut watch = StopWatch::default();
    for deceleration in [1.0, 1.5, 1.0, 1.5] {
        stop(&mut watch, 0.8, |_| deceleration, all);
        assert!(!watch.is_too_weak(LIMITS.braking));
    }
}

#[test]
fn the_error_of_the_speed_counts_for_the_car_and_not_for_what_is_relied_on() {
    // A tenth is less than what the error of 0.3 m/s makes, and more than that of 1 m/s.
    for (speed, share, weak) in [(0.3, 0.85, false), (1.0, 0.85, true), (0.3, 0.7, true)] {
        let mut watch = StopWatch::default();
        let mut measured = f64::INFINITY;
        for _ in 0..2 {
            let (_, stop) = stop(&mut watch, speed, |_| share * LIMITS.braking, all);
            measured = measured.min(stop.unwrap());
        }
        assert!(
            (measured / LIMITS.braking - share).abs() < 0.06,
            "{measured}"
        );
        assert_eq!(watch.is_too_weak(LIMITS.braking), weak, "{speed} {share}");
        assert_eq!(watch.relied_on(LIMITS.braking), measured);
    }
}

#[test]
fn a_stop_whose_way_is_no_number_leaves_what_was_measured_before() {
    let mut watch = StopWatch::default();
    stop(&mut watch, 1.0, |_| 0.9 * LIMITS.braking, all);
    let before = watch.lowest();
    let ticks = core::cell::Cell::new(0);
    let broken = |speed| {
        ticks.set(ticks.get() + 1);
        all(if ticks.get() == 60 { f64::NAN } else { speed })
    };
    let (_, measured) = stop(&mut watch, 1.0, |_| 0.9 * LIMITS.braking, broken);
    assert_eq!(measured, None);
    assert_eq!(watch.lowest(), before);
}

#[test]
fn a_stop_of_a_car_that_still_speeds_up_is_measured_from_its_highest_speed() {
    let mut watch = StopWatch::default();
    let mut speed = 0.25;
    let mut measured = None;
    watch.begin(at(0), &all(speed), 0.5, 1.0);
    for tick in 1..200 {
        let acceleration = if tick <= 10 { 1.0 } else { -1.4 };
        speed = f64::max(speed + 0.01 * acceleration, 0.0);
        let verdict = watch.tick(at(10 * tick), &all(speed), &LIMITS);
        measured = measured.or(verdict.measured);
    }
    assert!((1.3..2.0).contains(&measured.unwrap()), "{measured:?}");
}

#[test]
fn a_stop_from_a_low_speed_measures_nothing() {
    let (alarm, measured) = stop(&mut StopWatch::default(), 0.2, |_| 1.4, all);
    assert_eq!((alarm, measured), (None, None));
}

#[test]
fn both_stops_below_nine_tenths_or_one_below_six_tenths_are_too_weak() {
    for (one, other, weak) in [
        (None, None, false),
        (Some(1.8), Some(1.8), false),
        (Some(1.79), Some(1.79), true),
        (Some(1.79), Some(1.81), false),
        (Some(1.79), None, false),
        (Some(1.2), None, false),
        (Some(1.19), None, true),
        (Some(3.0), Some(1.19), true),
    ] {
        let watch = StopWatch {
            run: None,
            measured: [one, other].map(|stop| stop.map(Measured::exactly)),
        };
        assert_eq!(watch.is_too_weak(2.0), weak, "{one:?} {other:?}");
    }
    // Nothing is refused for ever.
    let watch = StopWatch {
        run: None,
        measured: [Some(Measured::exactly(0.0)); 2],
    };
    assert!(watch.is_too_weak(0.09) && !watch.is_too_weak(0.05));
    let mut watch = StopWatch::default();
    assert_eq!(watch.lowest(), f64::INFINITY);
    for (measured, lowest) in [(1.9, 1.9), (0.7, 0.7), (1.5, 0.7), (1.6, 1.5)] {
        watch.coasted(measured);
        assert_eq!(watch.lowest(), lowest);
    }
}

#[test]
fn a_stop_that_neither_motor_nor_cameras_saw_to_its_end_measures_nothing() {
    let dark = |estimate| Speeds {
        motor: None,
        cameras: None,
        estimate,
    };
    // From when to when, in ticks, and whether the estimate goes on.
    for (lost, back) in [(1, 600), (20, 600), (20, 21), (59, 600)] {
        for estimate in [None, Some(0.8), Some(-6.23)] {
            let mut watch = StopWatch::default();
            watch.begin(at(0), &all(0.8), 0.8, 1.0);
            for tick in 1..1_000_u32 {
                let speed = (0.8 - 0.014 * f64::from(tick)).max(0.0);
                let speeds = if (lost..back).contains(&tick) {
                    dark(estimate)
                } else {
                    all(speed)
                };
                let verdict = watch.tick(at(10 * u64::from(tick)), &speeds, &LIMITS);
                assert_eq!(
                    verdict,
                    StopVerdict::default(),
                    "{lost} {back} {estimate:?}"
                );
            }
            assert!(!watch.is_too_weak(LIMITS.braking));
        }
    }
}

#[test]
fn a_car_faster_than_the_ramp_rolls_free_from_then_on() {
    let elapsed = at(300).seconds_since(at(0));
    let ramp = 1.0 - 2.4 * elapsed;
    for (speed, free) in [
        (ramp, false),
        (ramp + 0.03, false),
        (ramp + 0.031, true),
        (ramp + 0.2, true),
    ] {
        let mut watch = StopWatch::default();
        watch.begin(at(0), &all(1.0), 1.0, 1.0);
        watch.tick(at(300), &all(speed), &LIMITS);
        let from = |watch: &StopWatch| watch.run.and_then(|run| run.free).map(|free| free.from);
        let expected = free.then_some(speed);
        assert_eq!(from(&watch), expected, "{speed}");
        if free {
            watch.tick(at(310), &all(speed - 0.01), &LIMITS);
            assert_eq!(from(&watch), expected, "{speed}");
        }
    }
}

/// The deceleration that a stop measures of a car that starts at 0.8 m/s under a ramp from
/// 1.28 m/s, by the deceleration of each moment (s).
fn measured(share: f64, deceleration: impl Fn(f64) -> f64) -> Option<f64> {
    let mut watch = StopWatch::default();
    let mut speed = 0.8;
    watch.begin(at(0), &all(speed), 1.28, share);
    (1..400).find_map(|tick| {
        speed = f64::max(speed - 0.01 * deceleration(0.01 * tick as f64), 0.0);
        watch.tick(at(10 * tick), &all(speed), &LIMITS).measured
    })
}

#[test]
fn a_brake_on_the_ramp_does_not_hide_that_the_car_rolls_freely() {
    let rolls = 0.6;
    // The ramp meets the car at 0.27 s. The brake then brings it closer again, once or twice.
    for brakes in [
        &[][..],
        &[(0.36, 0.42)],
        &[(0.33, 0.39)],
        &[(0.02, 0.06), (0.36, 0.42)],
        &[(0.33, 0.37), (0.42, 0.47)],
    ] {
        let braked = |time: f64| brakes.iter().any(|&(from, to)| time > from && time < to);
        let found = measured(1.0, |time| if braked(time) { 3.1 } else { rolls });
        let error = found.map_or(f64::INFINITY, |found| (found / rolls - 1.0).abs());
        assert!(error < 0.1, "{brakes:?}: {found:?}");
    }
}

#[test]
fn a_stop_that_brakes_to_the_end_measures_the_brake() {
    for brake in [1.2, 1.8, 2.4] {
        let found = measured(1.0, |_| brake);
        let error = found.map_or(f64::INFINITY, |found| (found / brake - 1.0).abs());
        assert!(error < 0.1, "{brake}: {found:?}");
    }
}

#[test]
fn the_slower_of_motor_and_cameras_counts_where_they_contradict_each_other() {
    let whole = measured(1.0, |_| 1.6);
    let less = measured(0.68, |_| 1.6);
    assert!(whole.is_some());
    assert_eq!(less, whole.map(|whole| 0.68 * whole));
}

#[test]
fn what_is_relied_on_is_the_lowest_of_configured_and_measured_decelerations() {
    let mut watch = StopWatch::default();
    assert_eq!(watch.relied_on(0.6), 0.6);
    for (measured, relied_on) in [(0.9, 0.6), (0.4, 0.4), (0.8, 0.4), (0.3, 0.3), (0.0, LEAST)] {
        watch.coasted(measured);
        assert_eq!(watch.relied_on(0.6), relied_on, "{measured}");
    }
}

#[test]
fn a_stop_that_is_not_obeyed_measures_what_it_has_slowed_down_so_far() {
    let (alarm, measured) = stop(&mut StopWatch::default(), 0.8, |_| 0.1, all);
    assert!(alarm.is_some());
    let measured = measured.unwrap_or(f64::NAN);
    assert!((0.05..0.15).contains(&measured), "{measured}");
}

#[test]
fn the_end_of_a_jog_measures_no_deceleration() {
    let mut watch = StopWatch::default();
    let mut speed = 1.0;
    watch.begin_after_jogging(at(0), &all(speed));
    for tick in 1..600 {
        speed = f64::max(speed - 0.004, 0.0);
        let verdict = watch.tick(at(10 * tick), &all(speed), &LIMITS);
        assert_eq!(verdict.measured, None);
    }
    assert!(!watch.is_underway() && !watch.is_too_weak(LIMITS.braking));
}
