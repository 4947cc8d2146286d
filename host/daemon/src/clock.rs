//! The clocks: `CLOCK_MONOTONIC` for every time in the daemon, and the wall clock for
//! names and mappings.

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
}
