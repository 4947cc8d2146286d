//! A car that something else drives: what would end its drive.

use singletrack_control::Time;
use singletrack_pilot::{Mode, Reason, SupervisorConfig};

use crate::bench::{Bench, DRIVING_FAILURES, FAILURES};

/// What would end the drive, in the next tick.
fn observed(bench: &mut Bench, drives: bool) -> (bool, Option<Reason>) {
    bench.prepare();
    let begins = bench.supervisor.observe(drives, bench.conditions.now);
    (begins, bench.supervisor.observed(&bench.conditions))
}

fn observing(mut bench: Bench) -> Bench {
    assert_eq!(observed(&mut bench, true), (true, None));
    bench.conditions.speed = 0.5;
    bench.conditions.motor_speed = 0.5;
    assert_eq!(observed(&mut bench, true), (false, None));
    bench
}

#[test]
fn a_drive_begins_where_the_car_is_driven_after_it_was_not() {
    let mut bench = Bench::new();
    let drives = [false, true, true, false, false, true, true];
    let begins = [false, true, false, false, false, true, false];
    for (tick, (drives, begins)) in drives.into_iter().zip(begins).enumerate() {
        assert_eq!(observed(&mut bench, drives), (begins, None), "tick {tick}");
        let mode = if drives { Mode::Driving } else { Mode::Idle };
        assert_eq!(bench.supervisor.mode(), mode, "tick {tick}");
        assert_eq!(bench.supervisor.reason(), None, "tick {tick}");
    }
}

#[test]
fn every_failure_would_end_an_observed_drive_and_is_told_again_in_each_tick() {
    for (name, reason, failure) in FAILURES.into_iter().chain(DRIVING_FAILURES) {
        let mut bench = observing(Bench::new());
        failure(&mut bench);
        let told = match reason {
            // A log has no path of ours that could end.
            Reason::ReferenceFinished => None,
            reason => Some(reason),
        };
        for _ in 0..2 {
            assert_eq!(observed(&mut bench, true), (false, told), "{name}");
        }
    }
}

#[test]
fn nothing_ends_a_drive_that_is_none() {
    for (name, _, failure) in FAILURES.into_iter().chain(DRIVING_FAILURES) {
        let mut bench = observing(Bench::new());
        failure(&mut bench);
        assert_eq!(observed(&mut bench, false), (false, None), "{name}");
    }
}

#[test]
fn a_board_that_no_log_tells_of_is_not_judged() {
    let mut bench = observing(Bench::unconnected(SupervisorConfig::paper()));
    // Long after the last status would have come.
    bench.conditions.now = Time(bench.conditions.now.0 + 5_000_000_000);
    assert_eq!(observed(&mut bench, true), (false, None));
    bench.conditions.overspeed = true;
    assert_eq!(observed(&mut bench, true), (false, Some(Reason::Overspeed)));
}

#[test]
fn a_pose_is_held_as_long_as_in_a_drive_of_ours() {
    let config = SupervisorConfig::paper();
    let mut bench = observing(Bench::new());
    bench.conditions.blind_distance = config.blind_distance;
    bench.pose_age_ms = 600;
    assert_eq!(observed(&mut bench, true), (false, None));
    bench.pose_age_ms = 601;
    let too_old = (false, Some(Reason::PoseTooOld));
    assert_eq!(observed(&mut bench, true), too_old);
}
