//! The clocks of the board and of the cameras, and the zero of the times at which something happens to
//! a car.

use singletrack_simavr::CYCLES_PER_US;

/// A clock with an offset and a rate error.
///
/// Integer arithmetic throughout: both directions are exact to the microsecond
/// and monotonic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SkewedClock {
    offset_us: u64,
    skew_ppm: i32,
}

const MILLION: u64 = 1_000_000;

impl SkewedClock {
    /// A clock that reads `offset_us` at simulation time zero and gains
    /// `skew_ppm` microseconds a second.
    ///
    /// The skew is limited to ± 100,000 ppm.
    pub fn new(offset_us: u64, skew_ppm: i32) -> Self {
        Self {
            offset_us,
            skew_ppm: skew_ppm.clamp(-100_000, 100_000),
        }
    }

    fn rate(&self) -> u64 {
        MILLION.saturating_add_signed(i64::from(self.skew_ppm))
    }

    /// Reading of the clock at a simulation time, in µs.
    pub fn at(&self, simulation_us: u64) -> u64 {
        let elapsed_us = counted(simulation_us, self.rate());
        self.offset_us.wrapping_add(elapsed_us)
    }

    /// The first simulation time at which the clock has advanced by `elapsed_us` of
    /// its own microseconds since simulation time zero.
    pub fn when_elapsed(&self, elapsed_us: u64) -> u64 {
        when(elapsed_us, self.rate())
    }

    /// Cycles of the clock's oscillator since simulation time zero.
    pub(crate) fn cycle_at(&self, simulation_us: u64) -> u64 {
        counted(simulation_us, self.rate() * CYCLES_PER_US)
    }

    /// The first simulation time, in µs, at which the oscillator has reached a
    /// cycle.
    pub(crate) fn when_cycle(&self, cycle: u64) -> u64 {
        when(cycle, self.rate() * CYCLES_PER_US)
    }
}

/// What is counted in a time, in µs, at a rate per second.
fn counted(us: u64, rate: u64) -> u64 {
    us / MILLION * rate + us % MILLION * rate / MILLION
}

/// The first time at which that much is counted, in µs.
fn when(count: u64, rate: u64) -> u64 {
    count / rate * MILLION + (count % rate * MILLION).div_ceil(rate)
}

/// Zero of all keys `..._at_s` and `..._from_s`; unknown until a drive has begun.
///
/// A drive does not begin at simulation time zero: bootloader, ESC and estimator come
/// first. Times in a configuration count from its beginning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Epoch(pub(crate) Option<u64>);

impl Default for Epoch {
    /// The start of the simulation.
    fn default() -> Self {
        Self(Some(0))
    }
}

impl Epoch {
    /// Time since zero, in s; `None` before it.
    pub(crate) fn elapsed_s(self, now_us: u64) -> Option<f64> {
        Some(now_us.checked_sub(self.0?)? as f64 * 1e-6)
    }

    /// Whether a time has come.
    pub(crate) fn has_come(self, at_s: Option<f64>, now_us: u64) -> bool {
        at_s.is_some_and(|at_s| self.elapsed_s(now_us).is_some_and(|now_s| now_s >= at_s))
    }

    /// Whether now lies in the window from `from_s` for `for_ms`.
    pub(crate) fn is_within(self, from_s: Option<f64>, for_ms: f64, now_us: u64) -> bool {
        let end_s = from_s.map(|from_s| from_s + for_ms * 1e-3);
        self.has_come(from_s, now_us) && !self.has_come(end_s, now_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fast_clock_gains() {
        let clock = SkewedClock::new(5, 3_000);
        assert_eq!(clock.at(0), 5);
        assert_eq!(clock.at(10_000_000), 5 + 10_030_000);
    }

    #[test]
    fn the_time_of_a_reading_is_the_first_with_it() {
        for skew in [-5_000, -17, 0, 1, 3_000, 99_999] {
            let clock = SkewedClock::new(0, skew);
            for elapsed in [1, 999, 1_000, 123_456_789, 86_400_000_000] {
                let when = clock.when_elapsed(elapsed);
                assert!(clock.at(when) >= elapsed, "{skew} {elapsed}");
                assert!(clock.at(when - 1) < elapsed, "{skew} {elapsed}");
                let cycle = elapsed * CYCLES_PER_US;
                let when = clock.when_cycle(cycle);
                assert!(clock.cycle_at(when) >= cycle, "{skew} {elapsed}");
                assert!(clock.cycle_at(when - 1) < cycle, "{skew} {elapsed}");
            }
        }
    }

    #[test]
    fn times_count_from_the_epoch_and_nothing_happens_without_one() {
        let epoch = Epoch(Some(3_000_000));
        assert!(!epoch.has_come(Some(0.0), 2_999_999));
        assert!(epoch.has_come(Some(0.0), 3_000_000));
        assert!(!epoch.has_come(Some(2.0), 4_999_999));
        assert!(epoch.has_come(Some(2.0), 5_000_000));
        assert!(!epoch.has_come(None, 9_000_000));
        assert!(!Epoch(None).has_come(Some(0.0), 9_000_000));
        let within = |now_us| epoch.is_within(Some(1.0), 500.0, now_us);
        assert!(!within(3_999_999) && within(4_000_000));
        assert!(within(4_499_999) && !within(4_500_000));
    }
}
