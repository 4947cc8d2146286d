//! Several cars.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_faults::{FleetBug, drive_fleet};

#[test]
fn a_schedule_of_several_cars_gives_the_same_bits_again_and_no_two_touch() {
    for seed in 0..4 {
        let outcome = drive_fleet(seed, 3, None).unwrap();
        assert_eq!(outcome.failure, None, "{seed}");
        assert_eq!(outcome, drive_fleet(seed, 3, None).unwrap());
    }
}

#[test]
fn cars_that_do_not_look_at_each_other_touch() {
    let found = (0..6).any(|seed| {
        let outcome = drive_fleet(seed, 3, Some(FleetBug::Blind)).unwrap();
        outcome.failure.is_some()
    });
    assert!(found);
}
