//! Well calibrated cars of all kinds: no watch ends their drives.
//!
//! `cargo run --release --example false_alarms -- --count 10000` drives many more.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use std::collections::BTreeSet;

use crate::calibrated::{CalibratedCar, Ended};

const DRIVES: u64 = 36;

#[test]
fn random_drives_of_calibrated_cars_have_no_false_alarm() {
    let mut proved = 0;
    let mut kinds = BTreeSet::new();
    for seed in 1..=DRIVES {
        let car = CalibratedCar::random(seed);
        let outcome = car.drive().unwrap();
        assert_eq!(
            outcome.ended,
            Ended::AsRequested,
            "seed {seed} after {:.2} s:\n{}",
            outcome.seconds,
            car.describe()
        );
        proved += u64::from(outcome.proved);
        kinds.extend(car.kinds().iter().cloned());
    }
    // Half of them begin unproved; the slowest need more than the time of the drive.
    assert!(3 * proved >= DRIVES, "{proved} of {DRIVES}");
    for (of, count) in [("reference: ", 6), ("ESC: ", 5), ("failsafe: ", 2)] {
        let drawn = kinds.iter().filter(|kind| kind.starts_with(of));
        assert_eq!(drawn.count(), count, "{kinds:?}");
    }
}
