//! The clocks: `CLOCK_MONOTONIC` for every time in the daemon, and the wall clock for
//! names and mappings.
//!
//! The daemon does not depend on the wall clock: a record maps its times to it once, at its
//! start. A step of it is logged, which helps to compare a record with others.

use std::time::{SystemTime, UNIX_EPOCH};

use jiff::Timestamp;
use rustix::{
    thread::clock_nanosleep_absolute,
    time::{ClockId, Timespec, clock_gettime},
};

const SECOND_NS: u64 = 1_000_000_000;

/// The present time, in nanoseconds of `CLOCK_MONOTONIC`.
pub fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    nanoseconds(now.tv_sec, now.tv_nsec)
}

/// Converts a `timespec`, whose fields have 32 bits on the Odroid.
pub(crate) fn nanoseconds(seconds: impl TryInto<u64>, nanoseconds: impl TryInto<u64>) -> u64 {
    // The clock counts from the start of the machine and is never negative.
    seconds.try_into().unwrap_or(0) * SECOND_NS + nanoseconds.try_into().unwrap_or(0)
}

/// Sleeps until `deadline_ns` of `CLOCK_MONOTONIC`; returns at once if it has passed.
pub(crate) fn sleep_until(deadline_ns: u64) {
    let deadline = Timespec {
        // The seconds have 64 bits on every platform; the nanoseconds are below 10^9.
        tv_sec: (deadline_ns / SECOND_NS) as _,
        tv_nsec: (deadline_ns % SECOND_NS) as _,
    };
    // A signal interrupts the sleep.
    while let Err(rustix::io::Errno::INTR) =
        clock_nanosleep_absolute(rustix::thread::ClockId::Monotonic, &deadline)
    {}
}

/// Nanoseconds of the wall clock since 1970; 0 before 1970.
pub(crate) fn wall_ns() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| {
            u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
        })
}

/// A time in UTC as `20250131T235959Z`.
pub(crate) fn compact_utc(wall_ns: u64) -> String {
    // All that fits into 64 bits is within the calendar: 1970 to 2554.
    Timestamp::from_nanosecond(i128::from(wall_ns))
        .unwrap_or_default()
        .strftime("%Y%m%dT%H%M%SZ")
        .to_string()
}

/// The smallest step: the two clocks are read one after the other.
const SMALLEST_STEP_NS: i64 = 100_000_000;

/// Compares the wall clock with the monotonic one.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct WallWatch {
    /// Wall minus monotonic time, as last reported.
    known_ns: Option<i64>,
    /// Whether the last reading showed another difference.
    suspected: bool,
}

impl WallWatch {
    /// Handles a reading of both clocks. Returns a step, in ns and positive forward, when two
    /// readings in a row show it: the thread may be delayed between the clocks of one reading.
    pub(crate) fn update(&mut self, monotonic_ns: u64, wall_ns: u64) -> Option<i64> {
        let difference_ns = wall_ns.wrapping_sub(monotonic_ns) as i64;
        let step_ns = difference_ns.wrapping_sub(*self.known_ns.get_or_insert(difference_ns));
        let differs = step_ns.unsigned_abs() >= SMALLEST_STEP_NS.unsigned_abs();
        let confirmed = differs && self.suspected;
        self.suspected = differs && !confirmed;
        confirmed.then(|| {
            self.known_ns = Some(difference_ns);
            step_ns
        })
    }
}

/// The line of the log for a step, in ns.
pub(crate) fn describe_step(step_ns: i64) -> String {
    let step_s = step_ns as f64 * 1e-9;
    format!("the wall clock was set by {step_s:+.3} s; times in the record are not affected")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_agree_with_the_calendar() {
        for (seconds, text) in [
            (0, "19700101T000000Z"),
            (951_782_399, "20000228T235959Z"),
            (951_782_400, "20000229T000000Z"),
            (1_735_689_599, "20241231T235959Z"),
            (1_735_689_600, "20250101T000000Z"),
            (4_107_542_400, "21000301T000000Z"),
            (18_446_744_073, "25540721T233433Z"),
        ] {
            assert_eq!(compact_utc(seconds * SECOND_NS), text);
        }
    }

    #[test]
    fn a_sleep_does_not_end_before_its_deadline() {
        let deadline = monotonic_ns() + 2_000_000;
        sleep_until(deadline);
        assert!(monotonic_ns() >= deadline);
        sleep_until(deadline - 1_000_000);
    }

    #[test]
    fn a_step_of_an_hour_and_back_is_reported_once_each() {
        let mut watch = WallWatch::default();
        let mut reported = Vec::new();
        for reading in 0..60_u64 {
            let hour = if (20..40).contains(&reading) {
                3_600
            } else {
                0
            };
            let monotonic = 1_000 * SECOND_NS + reading * SECOND_NS / 50;
            let step = watch.update(monotonic, monotonic + (1_000_000 + hour) * SECOND_NS);
            reported.extend(step.map(|step| (reading, step)));
        }
        let hour_ns = 3_600 * SECOND_NS as i64;
        assert_eq!(reported, [(21, hour_ns), (41, -hour_ns)]);
        assert!(describe_step(hour_ns).starts_with("the wall clock was set by +3600.000 s"));
    }

    #[test]
    fn a_pause_within_one_reading_is_no_step() {
        let mut watch = WallWatch::default();
        for reading in 0..50_u64 {
            let monotonic = reading * SECOND_NS;
            let pause = if reading % 7 == 3 { SECOND_NS } else { 0 };
            assert_eq!(
                watch.update(monotonic, 5 * SECOND_NS + monotonic + pause),
                None
            );
        }
    }
}
