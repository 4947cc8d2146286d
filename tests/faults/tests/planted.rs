//! Planted bugs are found, named, shrunk and reproduced.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::collections::BTreeSet;

use singletrack_faults::{
    Tamper, Untampered, Until, Violation, attempt, drive, names,
    planted::{BUGS, prolonged},
    schedule::{FaultKind, Schedule},
    shrink,
};
use singletrack_record::TickRecord;
use singletrack_sim::BoardKind;

/// A drive along the circle, with additional entries.
fn schedule(entries: &str) -> Schedule {
    format!("seed 5; end_ms 9000; ask arm at 3200; {entries}")
        .parse()
        .unwrap()
}

#[test]
fn every_invariant_has_a_planted_bug() {
    let planted: BTreeSet<_> = BUGS.iter().map(|bug| bug.invariant).collect();
    for name in names().unwrap() {
        let elsewhere = matches!(name, "panic" | "repeatable");
        assert!(elsewhere || planted.contains(name), "{name}");
    }
}

#[test]
fn a_longer_time_to_live_is_found_and_shrunk() {
    // One of these faults silences the host.
    let more = "speed_mm_s 800; fault imu-biased at 3500 for 300 severity 40; \
                fault battery-low at 4000 for 900 severity 20; \
                fault daemon-paused at 6000 for 900 severity 500; \
                fault camera-duplicated at 6500 for 900 severity 100; ask arm at 8500; \
                truth servo-trim-us 10; truth rolling-mm-s2 900";
    let schedule = schedule(more);
    let sound = attempt(&schedule, &mut Untampered).unwrap();
    assert_eq!(sound.violation, None);
    let found: Violation = attempt(&schedule, &mut prolonged(60_000))
        .unwrap()
        .violation
        .unwrap();
    assert_eq!(found.invariant, "command-age");
    let (small, again) = shrink(&schedule, &found, || prolonged(60_000)).unwrap();
    assert_eq!(again.invariant, found.invariant);
    assert_eq!(small.faults.len(), 1, "{small}");
    assert!(small.faults[0].for_ms < 200, "{small}");
    assert_eq!(small.requests.len(), 1, "{small}");
    assert_eq!(small.situation.speed_mm_s, 500, "{small}");
    assert!(small.truth.deviations.is_empty(), "{small}");
    // Its text reproduces the violation.
    let read: Schedule = small.in_one_line().parse().unwrap();
    let replayed = attempt(&read, &mut prolonged(60_000)).unwrap();
    assert_eq!(replayed.violation, Some(again));
}

/// A pilot that panics.
struct Panics;

impl Tamper for Panics {
    fn tick(&mut self, tick: &mut TickRecord) {
        assert!(tick.index < 600, "out of cheese");
    }
}

#[test]
fn a_panic_is_a_violation_with_its_message() {
    let outcome = attempt(&schedule(""), &mut Panics).unwrap();
    let found = outcome.violation.unwrap();
    assert_eq!(found.invariant, "panic");
    assert_eq!(found.details, "out of cheese");
}

/// Left out of `cargo verify`, not of `--all`: they take seconds of processor time each.
mod thorough {
    use super::*;

    #[test]
    fn every_planted_bug_is_found_by_its_invariant() {
        let mut missed = Vec::new();
        for bug in BUGS {
            let (is_found, first) = bug.is_found(&bug.schedule().unwrap()).unwrap();
            if !is_found {
                missed.push((bug.name, bug.invariant, first));
            }
        }
        assert!(missed.is_empty(), "{missed:#?}");
    }

    #[test]
    fn nothing_is_found_without_the_bugs() {
        let examples: BTreeSet<_> = BUGS.iter().map(|bug| bug.example).collect();
        for example in examples {
            let outcome = drive(&schedule(example), &mut Untampered, Until::End).unwrap();
            assert_eq!(outcome.violation, None, "{example}");
            let runs = outcome.reasons.contains("runs-at-neutral");
            assert!(outcome.driven_ms > 500 || runs, "{example}");
        }
    }

    #[test]
    fn hostile_outer_loops_get_past_a_filter_that_passes_everything() {
        let schedules = (1..=160).map(|seed| Schedule::generate(seed, BoardKind::Native));
        let hostile = |schedule: &Schedule| {
            let mut kinds = schedule.faults.iter().map(|fault| fault.kind);
            schedule.situation.safety_filter && kinds.any(FaultKind::is_hostile_loop)
        };
        let schedules: Vec<_> = schedules.filter(hostile).collect();
        let found = BUGS
            .iter()
            .filter(|bug| bug.invariant == "filter")
            .map(|bug| {
                let found = schedules
                    .iter()
                    .filter(|schedule| bug.is_found(schedule).unwrap().0);
                (bug.name, found.count())
            });
        let found: Vec<_> = found.collect();
        assert!(found.iter().all(|(_, count)| *count > 0), "{found:?}");
    }
}
