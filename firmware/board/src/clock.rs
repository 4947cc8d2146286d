//! Time on a clock that wraps every 71 minutes.
//!
//! The difference of two instants is valid only if they are less than half a turn
//! apart. Longer durations are measured by adding the times between polls, and
//! saturate instead of wrapping.

/// Half a turn of the clock; polls are closer together than this.
const HALF_TURN_US: u32 = 1 << 31;

/// Time from `then` to `now`, in µs; `None` if `then` lies in the future.
pub(crate) fn age_us(now_us: u32, then_us: u32) -> Option<u32> {
    let age = now_us.wrapping_sub(then_us);
    (age < HALF_TURN_US).then_some(age)
}

/// Measures a duration; saturates instead of wrapping.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stopwatch(u32);

impl Stopwatch {
    /// A stopwatch started now.
    pub(crate) const fn started() -> Self {
        Self(0)
    }

    /// A stopwatch started a given time ago, in µs.
    pub(crate) const fn started_ago(us: u32) -> Self {
        Self(us)
    }

    #[inline(never)]
    pub(crate) const fn advance(&mut self, elapsed_us: u32) {
        // Stops in the upper half of the range: no step leads from the lower half
        // beyond the end. Testing one bit is cheaper than saturating.
        if self.0 < HALF_TURN_US {
            self.0 = self.0.wrapping_add(elapsed_us);
        }
    }

    pub(crate) const fn elapsed_us(self) -> u32 {
        self.0
    }
}

/// Fires once per period, without drift if polled late.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ticker<const PERIOD_US: u32> {
    left_us: u32,
}

impl<const PERIOD_US: u32> Ticker<PERIOD_US> {
    /// A ticker that fires at the first poll, and then every `PERIOD_US`.
    pub(crate) const fn new() -> Self {
        Self { left_us: 0 }
    }

    /// Whether the period has ended. Missed periods are not made up for.
    pub(crate) const fn advance(&mut self, elapsed_us: u32) -> bool {
        if elapsed_us < self.left_us {
            self.left_us -= elapsed_us;
            return false;
        }
        self.begin_period(elapsed_us - self.left_us);
        true
    }

    #[inline(never)]
    const fn begin_period(&mut self, late_us: u32) {
        self.left_us = if late_us < PERIOD_US {
            PERIOD_US - late_us
        } else {
            PERIOD_US
        };
    }
}

#[cfg(test)]
mod tests {
    use super::{HALF_TURN_US, Stopwatch, Ticker, age_us};

    #[test]
    fn an_age_is_correct_across_the_wrap_and_none_in_the_future() {
        assert_eq!(age_us(5, 5), Some(0));
        assert_eq!(age_us(5, u32::MAX - 4), Some(10));
        assert_eq!(age_us(u32::MAX - 4, 5), None);
    }

    #[test]
    fn half_a_turn_is_ambiguous_and_has_no_age() {
        assert_eq!(age_us(HALF_TURN_US - 1, 0), Some(HALF_TURN_US - 1));
        assert_eq!(age_us(HALF_TURN_US, 0), None);
    }

    #[test]
    fn a_stopwatch_saturates() {
        for long_us in [HALF_TURN_US, HALF_TURN_US + 1, u32::MAX] {
            let mut watch = Stopwatch::started();
            watch.advance(long_us);
            for elapsed_us in [10, HALF_TURN_US, u32::MAX] {
                watch.advance(elapsed_us);
                assert_eq!(watch.elapsed_us(), long_us);
            }
        }
    }

    #[test]
    fn a_ticker_polled_late_keeps_its_phase_and_skips_missed_periods() {
        let mut ticker = Ticker::<10>::new();
        assert!(ticker.advance(0));
        assert!(!ticker.advance(9));
        assert!(ticker.advance(4));
        assert!(!ticker.advance(6));
        assert!(ticker.advance(1));
        assert!(ticker.advance(35));
        assert!(!ticker.advance(9));
        assert!(ticker.advance(1));
    }

    #[test]
    fn a_late_ticker_fires_once() {
        for late_us in [0, 10, 20, 30, 1_000] {
            let mut ticker = Ticker::<10>::new();
            assert!(ticker.advance(late_us));
            assert!(!ticker.advance(0), "{late_us}");
        }
    }
}
