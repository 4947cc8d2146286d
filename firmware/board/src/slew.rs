//! Limits the rate of change of a pulse: between two times, at most the rate allows
//! for the time between them plus one poll.

/// A stall of the main loop allows at most the change of one servo frame.
const MAX_STEP_US: u16 = 20_000;

/// Fractional bits of the allowed change per microsecond.
///
/// The largest number that fits: the highest rate (1400 µs in 20 ms) and the
/// longest step need 16 bits each. There is no division and no wider
/// multiplication, which would be slow on the AVR in every poll.
const FRACTION_BITS: u32 = 19;

/// A rate of change, with the remainder between polls.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SlewLimiter {
    /// µs of pulse per µs of time, in fixed point.
    rate: u16,
    /// Fraction of a µs of pulse.
    remainder: u32,
}

impl SlewLimiter {
    /// Rounds down: never faster than configured, and less than 2 % slower.
    pub(crate) const fn new(us_per_20ms: u16) -> Self {
        Self {
            rate: (((us_per_20ms as u32) << FRACTION_BITS) / 20_000) as u16,
            remainder: 0,
        }
    }

    /// The pulse after moving from `current` towards `target` for `elapsed_us`.
    #[inline(never)]
    pub(crate) fn approach(&mut self, current: i16, target: i16, elapsed_us: u32) -> i16 {
        if current == target {
            self.remainder = 0;
            return target;
        }
        let elapsed_us = u16::try_from(elapsed_us).map_or(MAX_STEP_US, |us| us.min(MAX_STEP_US));
        let allowed = self.remainder + u32::from(self.rate) * u32::from(elapsed_us);
        self.remainder = allowed & ((1 << FRACTION_BITS) - 1);
        // At most 1401; see `FRACTION_BITS`.
        let allowed = (allowed >> FRACTION_BITS) as i16;
        if current < target {
            current.saturating_add(allowed).min(target)
        } else {
            current.saturating_sub(allowed).max(target)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::SlewLimiter;

    #[test]
    fn the_change_in_a_given_time_does_not_depend_on_the_poll_rate() {
        for rate in [1, 7, 90, 1_400] {
            for (polls, every_us) in [(1_000, 1_000), (10_000, 100), (77, 13_000), (50, 20_000)] {
                let mut slew = SlewLimiter::new(rate);
                let mut pulse = 0;
                let mut elapsed = 0;
                for _ in 0..polls {
                    pulse = slew.approach(pulse, i16::MAX, every_us);
                    elapsed += every_us;
                }
                let allowed = i64::from(rate) * i64::from(elapsed) / 20_000;
                let allowed = allowed.min(i16::MAX.into());
                let shortfall = allowed - i64::from(pulse);
                assert!(
                    (0..=1 + allowed / 50).contains(&shortfall),
                    "{rate}: {pulse} of {allowed}"
                );
            }
        }
    }

    #[test]
    fn after_a_stall_of_any_length_the_change_is_that_of_one_servo_frame() {
        for stall_us in [20_000, 20_001, 40_000, 65_535, 65_536, 10_000_000] {
            let mut slew = SlewLimiter::new(96);
            let pulse = slew.approach(0, 1_000, stall_us);
            assert!((95..=96).contains(&pulse), "{pulse} after {stall_us} us");
        }
    }

    #[test]
    fn the_target_is_reached_exactly_from_both_sides() {
        let mut slew = SlewLimiter::new(100);
        assert_eq!(slew.approach(1_500, 1_504, 1_000), 1_504);
        assert_eq!(slew.approach(1_500, 1_496, 1_000), 1_496);
        let pulse = slew.approach(1_500, 1_600, 2_000);
        assert!((1_509..=1_510).contains(&pulse), "{pulse}");
    }

    #[test]
    fn waiting_at_the_target_accumulates_nothing() {
        let mut slew = SlewLimiter::new(100);
        for _ in 0..100 {
            slew.approach(1_500, 1_500, 999);
        }
        assert!(slew.approach(1_500, 1_600, 1_000) <= 1_505);
    }

    #[test]
    fn a_stall_allows_the_change_of_one_servo_frame() {
        let mut slew = SlewLimiter::new(1_400);
        let pulse = slew.approach(0, i16::MAX, u32::MAX);
        assert!((1_399..=1_400).contains(&pulse), "{pulse}");
    }
}
