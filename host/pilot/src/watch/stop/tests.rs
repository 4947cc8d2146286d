//! Stops that obey and stops that do not.

mod measured;

use super::*;

const LIMITS: StopLimits = StopLimits {
    braking: 1.4,
    ramp: 2.4,
    standing: 0.03,
};

fn at(ms: u64) -> Time {
    Time(1_000_000_000 + ms * 1_000_000)
}

/// A stop from `speed` with the deceleration of each moment, by its speed; the time of
/// the alarm in ms, and the measured deceleration.
fn stop(
    watch: &mut StopWatch,
    speed: f64,
    deceleration: impl Fn(f64) -> f64,
    seen: impl Fn(f64) -> Speeds,
) -> (Option<u64>, Option<f64>) {
    let mut speed = speed;
    let mut measured = None;
    watch.begin(at(0), &seen(speed), speed, 1.0);
    for tick in 1..600 {
        // The geofence's reaction time is allowed for.
        if tick > 5 {
            speed = (speed - 0.01 * deceleration(speed)).max(0.0);
        }
        let verdict = watch.tick(at(10 * tick), &seen(speed), &LIMITS);
        measured = measured.or(verdict.measured);
        if verdict.disobeyed {
            return (Some(10 * tick), measured);
        }
    }
    (None, measured)
}

const fn all(speed: f64) -> Speeds {
    Speeds {
        motor: Some(speed),
        cameras: Some(speed),
        estimate: Some(speed),
    }
}

#[test]
fn a_speed_that_does_not_fall_is_disobeyed_within_half_a_second() {
    for speed in [0.2, 0.5, 1.5] {
        for deceleration in [0.0, 0.05, -1.0] {
            let (alarm, _) = stop(&mut StopWatch::default(), speed, |_| deceleration, all);
            assert!(alarm.is_some_and(|ms| ms <= 550), "{speed}: {alarm:?}");
        }
    }
}

#[test]
fn either_of_motor_and_cameras_shows_a_stop_that_is_not_obeyed() {
    let motor = |_| Speeds {
        motor: Some(0.5),
        cameras: Some(0.0),
        estimate: Some(0.0),
    };
    let (alarm, _) = stop(&mut StopWatch::default(), 0.5, |_| 1.4, motor);
    assert!(alarm.is_some_and(|ms| ms <= 900), "{alarm:?}");
    let cameras = |_| Speeds {
        motor: None,
        cameras: Some(0.5),
        estimate: None,
    };
    let (alarm, _) = stop(&mut StopWatch::default(), 0.5, |_| 1.4, cameras);
    assert!(alarm.is_some_and(|ms| ms <= 550), "{alarm:?}");
}

#[test]
fn a_car_that_follows_the_ramp_upward_obeys() {
    let mut watch = StopWatch::default();
    watch.begin(at(0), &all(1.0), 1.0, 1.0);
    for tick in 1..100 {
        let elapsed = 0.01 * tick as f64;
        // The brake was too strong, and the board catches up with the ramp.
        let speed = if (0.2..0.3).contains(&elapsed) {
            0.25
        } else {
            (1.0 - 2.4 * (elapsed - 0.1)).clamp(0.0, 1.0)
        };
        let verdict = watch.tick(at(10 * tick), &all(speed), &LIMITS);
        assert!(!verdict.disobeyed, "{elapsed}");
    }
}

#[test]
fn a_first_speed_of_a_coarse_motor_sensor_after_the_reaction_time_is_no_alarm() {
    let mut watch = StopWatch::default();
    let mut speed = 0.3;
    watch.begin(at(0), &all(speed), 0.3, 1.0);
    for tick in 1..100 {
        speed = f64::max(speed - 0.01, 0.0);
        let speeds = Speeds {
            motor: Some(if (26..60).contains(&tick) { 0.18 } else { 0.0 }),
            ..all(speed)
        };
        let verdict = watch.tick(at(10 * tick), &speeds, &LIMITS);
        assert!(!verdict.disobeyed, "{tick}");
    }
}

#[test]
fn a_car_that_sets_off_after_its_stop_was_slow_is_disobeyed() {
    let mut watch = StopWatch::default();
    watch.begin(at(0), &all(0.1), 0.1, 1.0);
    let disobeyed = (1..150).find(|tick| {
        let speed = if *tick < 40 {
            0.05
        } else {
            0.05 + 0.01 * f64::from(tick - 40)
        };
        watch
            .tick(at(10 * *tick as u64), &all(speed), &LIMITS)
            .disobeyed
    });
    assert!(disobeyed.is_some_and(|tick| tick <= 60), "{disobeyed:?}");
}

#[test]
fn a_car_that_is_pushed_after_it_stood_is_no_alarm() {
    let mut watch = StopWatch::default();
    assert_eq!(stop(&mut watch, 0.5, |_| 1.4, all).0, None);
    for tick in 600..1_000 {
        let verdict = watch.tick(at(10 * tick), &all(1.0), &LIMITS);
        assert_eq!(verdict, StopVerdict::default());
    }
}

#[test]
fn a_measured_speed_must_fall_by_the_least_deceleration() {
    let fallen = |from, elapsed, speed, floor| {
        let mut fall = Fall {
            from: Some((from, at(0))),
            too_fast: 0,
            ..Fall::default()
        };
        fall.tick(at(elapsed), speed, 0.2, floor);
        fall.too_fast == 0
    };
    for (from, elapsed, speed, floor, obeys) in [
        // Just as much as is allowed.
        (0.5, 0, 0.5 + 0.03, 0.0, true),
        (0.5, 100, 0.509, 0.0, true),
        (0.5, 100, 0.511, 0.0, false),
        (0.5, 100, -0.511, 0.0, false),
        (0.5, 100, f64::NAN, 0.0, false),
        (0.5, 100, 0.599, 0.6, true),
        (0.5, 100, 0.601, 0.6, false),
        // From a slow speed nothing is judged.
        (0.08, 0, 0.2, 0.0, false),
        (0.079, 0, 0.2, 0.0, true),
    ] {
        let found = fallen(from, elapsed, Some(speed), floor);
        assert_eq!(found, obeys, "{from} {elapsed} {speed} {floor}");
    }
    assert!(fallen(0.5, 100, None, 0.0));
}

#[test]
fn the_worst_speed_is_the_larger_one_of_those_measured() {
    for (motor, cameras, expected) in [
        (None, None, None),
        (Some(-0.5), None, Some(0.5)),
        (None, Some(-0.4), Some(0.4)),
        (Some(-0.5), Some(0.4), Some(0.5)),
        (Some(0.5), Some(-0.6), Some(0.6)),
    ] {
        let speeds = Speeds {
            motor,
            cameras,
            estimate: None,
        };
        assert_eq!(speeds.worst(), expected);
    }
}

#[test]
fn the_next_drive_ends_the_watch_of_a_stop() {
    let mut watch = StopWatch::default();
    watch.begin(at(0), &all(1.0), 1.0, 1.0);
    watch.end();
    for tick in 1..200 {
        let verdict = watch.tick(at(10 * tick), &all(1.0), &LIMITS);
        assert_eq!(verdict, StopVerdict::default());
    }
}

#[test]
fn a_deceleration_below_fifteen_hundredths_of_the_configured_one_is_disobeyed() {
    let alarm = |deceleration| {
        let watch = &mut StopWatch::default();
        stop(watch, 1.0, |_| deceleration, all).0.is_some()
    };
    assert!(alarm(0.19) && !alarm(0.23));
}

#[test]
fn a_speed_up_to_a_fifth_of_a_second_behind_the_ramp_obeys() {
    for (beyond, obeys) in [(-0.01, true), (0.01, false)] {
        let mut watch = StopWatch::default();
        watch.begin(at(0), &all(1.0), 1.0, 1.0);
        let disobeyed = (1..50).any(|tick| {
            let behind = 1.0 - 2.4 * (0.01 * tick as f64 - 0.2);
            let speed = if tick < 30 { 0.1 } else { behind + beyond };
            let verdict = watch.tick(at(10 * tick), &all(speed), &LIMITS);
            verdict.disobeyed
        });
        assert_eq!(disobeyed, !obeys, "{beyond}");
    }
}

#[test]
fn wheels_that_turn_have_longer_to_stop_if_the_cameras_see_the_car_stand_or_slow_down() {
    let slows = |seen: f64| move |time: f64| seen - 0.3 * time;
    let stands = |seen: f64| move |_: f64| seen;
    let alarm = |seen: &dyn Fn(f64) -> f64| {
        let mut watch = StopWatch::default();
        let speeds = |tick: u64| Speeds {
            motor: Some(0.5),
            cameras: Some(seen(0.01 * tick as f64)),
            estimate: Some(0.5),
        };
        watch.begin(at(0), &speeds(0), 0.5, 1.0);
        (1..200)
            .find(|&tick| watch.tick(at(10 * tick), &speeds(tick), &LIMITS).disobeyed)
            .map(|tick| 10 * tick)
    };
    for (seen, least_ms, most_ms) in [
        (&stands(0.2) as &dyn Fn(f64) -> f64, 400, 450),
        (&stands(0.08), 750, 850),
        (&slows(0.5), 750, 850),
    ] {
        let alarm = alarm(seen);
        assert!(
            alarm.is_some_and(|ms| (least_ms..=most_ms).contains(&ms)),
            "{}: {alarm:?}",
            seen(0.0)
        );
    }
}

#[test]
fn a_car_that_slows_down_a_little_and_then_keeps_its_speed_does_not_obey() {
    // It is believed to roll well: 0.06 m/s² would be enough, and it has lost more at first.
    let limits = StopLimits {
        braking: 0.41,
        ..LIMITS
    };
    for first in [0.0, 0.1, 0.3, 0.6] {
        let mut watch = StopWatch::default();
        let seen = |tick: u64| {
            let time = 0.01 * tick as f64;
            // Noise of the cameras.
            let noise = if tick.is_multiple_of(2) { 0.02 } else { -0.02 };
            let speed = 1.2 - 0.4 * time.min(0.25 + first);
            Speeds {
                motor: None,
                cameras: Some(speed + noise),
                estimate: Some(speed),
            }
        };
        watch.begin(at(0), &seen(0), 0.0, 1.0);
        let alarm =
            (1..400).find(|&tick| watch.tick(at(10 * tick), &seen(tick), &limits).disobeyed);
        let after = alarm.map(|tick| 0.01 * tick as f64 - 0.25 - first);
        assert!(
            after.is_some_and(|after| (0.2..1.7).contains(&after)),
            "{first}: {after:?}"
        );
    }
}

#[test]
fn a_coarse_motor_sensor_that_shows_the_start_late_is_no_stop_that_is_not_obeyed() {
    // Asked to stop 40 ms after it started: the pulses before and after are far apart, so that the
    // first one of the roll-out shows a mean speed from before it, above what was shown last.
    let mut watch = StopWatch::default();
    let seen = |tick: u64| {
        let rising = 0.11 + 0.014 * tick as f64;
        let falling = 0.25 - 0.007 * tick.saturating_sub(10) as f64;
        rising.min(falling).max(0.0)
    };
    let speeds = |tick: u64| Speeds {
        motor: Some(match tick {
            0..8 => 0.149,
            8..28 => 0.114,
            28..40 => 0.189,
            _ => seen(tick),
        }),
        cameras: Some(seen(tick)),
        estimate: Some(seen(tick)),
    };
    watch.begin(at(0), &speeds(0), 0.3, 1.0);
    for tick in 1..100 {
        let verdict = watch.tick(at(10 * tick), &speeds(tick), &LIMITS);
        assert!(!verdict.disobeyed, "{tick}");
    }
}

#[test]
fn a_stop_ends_when_the_car_has_stood_for_a_fifth_of_a_second_or_takes_too_long() {
    // Without a measurement of motor or cameras the car may still move.
    let unseen = Speeds {
        motor: None,
        cameras: None,
        estimate: Some(0.430_5),
    };
    // 0.25 s, 1 s, and the way down from 0.4305 m/s at 0.21 m/s².
    for (speeds, last_ms) in [(unseen, 3_300), (all(0.05), 3_300), (all(0.049), 210)] {
        let mut watch = StopWatch::default();
        watch.begin(at(0), &unseen, 0.430_5, 1.0);
        let first = Speeds {
            estimate: Some(0.430_5),
            ..speeds
        };
        let ended = (1..400).find(|tick| {
            watch.tick(at(10 * tick), &first, &LIMITS);
            watch.run.is_none()
        });
        assert!(
            ended.is_some_and(|tick| (10 * tick).abs_diff(last_ms) <= 10),
            "{speeds:?}: {ended:?}"
        );
    }
}

#[test]
fn a_car_that_is_taken_up_after_it_stood_under_noisy_cameras_is_no_alarm() {
    // As the cameras of a car with 0.4 mm of noise saw it, and its motor sensor with a pulse every
    // 29 mm: a hand comes 0.8 s after the stop has begun.
    let mut watch = StopWatch::default();
    watch.begin(at(0), &all(0.3), 0.3, 1.0);
    for tick in 1..=120_u32 {
        let seconds = 0.01 * f64::from(tick);
        let noise = if tick % 7 == 0 { 0.045 } else { 0.01 };
        let seen = noise + 0.6 * (seconds - 0.8).max(0.0);
        let motor = if tick < 53 { 0.029 / seconds } else { 0.0 };
        let speeds = Speeds {
            motor: Some(motor.min(0.3)),
            cameras: Some(seen),
            estimate: Some(seen),
        };
        let verdict = watch.tick(at(10 * u64::from(tick)), &speeds, &LIMITS);
        assert!(!verdict.disobeyed, "{seconds}");
    }
    assert!(!watch.is_underway());
}

#[test]
fn cameras_that_drift_on_after_they_ended_the_drive_do_not_make_a_stop_that_is_not_obeyed() {
    let drifting = |drift: f64| {
        move |speed: f64| Speeds {
            motor: Some(speed),
            cameras: Some(speed.max(drift)),
            estimate: Some(speed.max(drift)),
        }
    };
    for (drift, doubted, alarms) in [
        (0.1, true, false),
        (0.2, true, false),
        // Faster than any drift: whatever it is that moves, somebody must look.
        (0.4, true, true),
        // Nothing had spoken against the cameras.
        (0.1, false, true),
    ] {
        let mut watch = StopWatch::default();
        if doubted {
            watch.begin(Time(0), &drifting(drift)(0.5), 0.5, 1.0);
            watch.doubt_cameras();
        }
        let (alarm, _) = stop(&mut watch, 0.5, |_| 1.4, drifting(drift));
        assert_eq!(alarm.is_some(), alarms, "{drift} m/s, {doubted}: {alarm:?}");
    }
    // A motor sensor that shows nothing, or never showed that the wheels turn, does not vouch for them.
    for motor in [None, Some(0.0)] {
        let mut watch = StopWatch::default();
        let blind = |speed: f64| Speeds {
            motor,
            ..drifting(0.1)(speed)
        };
        watch.begin(Time(0), &blind(0.5), 0.5, 1.0);
        watch.doubt_cameras();
        let (alarm, _) = stop(&mut watch, 0.5, |_| 1.4, blind);
        assert!(alarm.is_some(), "{motor:?}");
    }
}
