//! The watchdog, data sheet chapter 10.8: a counter at 128 kHz.

const WDIF: u8 = 0x80;
const WDIE: u8 = 0x40;
const WDP3: u8 = 0x20;
const WDCE: u8 = 0x10;
const WDE: u8 = 0x08;

/// Cycles of 16 MHz per count of 128 kHz.
const CYCLES_PER_COUNT: u64 = 125;
/// Number of cycles in which a change is allowed.
const CHANGE: u64 = 4;

#[derive(Debug, Default)]
pub(crate) struct Watchdog {
    control: u8,
    counts_since: u64,
    /// End of the time in which prescaler and enable may be written.
    open_until: Option<u64>,
}

impl Watchdog {
    pub(crate) fn read(&self, now: u64) -> u8 {
        let open = self.open_until.is_some_and(|until| now <= until);
        self.control | if open { WDCE } else { 0 }
    }

    pub(crate) fn write(&mut self, now: u64, value: u8) {
        let ran = self.runs();
        let open = self.open_until.take().is_some_and(|until| now <= until);
        let flag = self.control & WDIF & !value;
        if value & WDCE != 0 && value & WDE != 0 {
            self.open_until = Some(now + CHANGE);
        }
        let settings = if open {
            value & (WDE | WDP3 | 7)
        } else {
            (self.control | value & WDE) & (WDE | WDP3 | 7)
        };
        self.control = flag | value & WDIE | settings;
        if !ran {
            self.counts_since = now;
        }
    }

    /// The instruction WDR.
    pub(crate) fn restart(&mut self, now: u64) {
        self.counts_since = now;
    }

    fn runs(&self) -> bool {
        self.control & (WDE | WDIE) != 0
    }

    pub(crate) fn next(&self) -> u64 {
        if !self.runs() {
            return u64::MAX;
        }
        let prescaler = (self.control & 7) | (self.control & WDP3) >> 2;
        self.counts_since + ((2_048 * CYCLES_PER_COUNT) << prescaler.min(9))
    }

    /// Time of a reset, if it occurs by now.
    pub(crate) fn advance(&mut self, now: u64) -> Option<u64> {
        let due = self.next();
        if due > now {
            return None;
        }
        // An interrupt that is not served by the next timeout does not prevent the reset.
        let unserved = self.control & WDIF != 0 && self.control & WDE != 0;
        if self.control & WDIE != 0 && !unserved {
            self.control |= WDIF;
            self.counts_since = due;
            return None;
        }
        Some(due)
    }

    pub(crate) fn requests(&self) -> bool {
        self.control & WDIF != 0 && self.control & WDIE != 0
    }

    /// Notes the service of its interrupt; the next timeout resets.
    pub(crate) fn served(&mut self) {
        self.control &= !WDIF;
        if self.control & WDE != 0 {
            self.control &= !WDIE;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 16_000;

    /// Enabled for 64 ms, as the data sheet has it.
    fn enabled() -> Watchdog {
        let mut watchdog = Watchdog::default();
        watchdog.write(10, WDCE | WDE);
        watchdog.write(12, WDE | 2);
        watchdog
    }

    #[test]
    fn it_counts_from_the_last_restart() {
        let mut watchdog = enabled();
        assert_eq!(watchdog.next(), 10 + 64 * MS);
        watchdog.restart(50 * MS);
        assert_eq!(watchdog.next(), 114 * MS);
        assert_eq!(watchdog.advance(114 * MS - 1), None);
        assert_eq!(watchdog.advance(114 * MS + 2), Some(114 * MS));
    }

    #[test]
    fn it_changes_only_within_four_cycles_of_the_key() {
        let mut watchdog = enabled();
        watchdog.write(100, WDCE | WDE);
        watchdog.write(105, 0);
        assert_eq!(watchdog.next(), 10 + 64 * MS);
        watchdog.write(200, 0);
        assert_eq!(watchdog.next(), 10 + 64 * MS);
        watchdog.write(300, WDCE | WDE);
        watchdog.write(304, 0);
        assert_eq!(watchdog.next(), u64::MAX);
    }

    #[test]
    fn with_its_interrupt_enabled_it_interrupts_before_it_resets() {
        let mut watchdog = enabled();
        watchdog.write(100, WDIE);
        let due = watchdog.next();
        assert_eq!(watchdog.advance(due), None);
        assert!(watchdog.requests());
        watchdog.served();
        assert!(!watchdog.requests());
        assert_eq!(watchdog.advance(due + 64 * MS), Some(due + 64 * MS));
    }
    #[test]
    fn an_unserved_interrupt_is_followed_by_a_reset() {
        let mut watchdog = enabled();
        watchdog.write(100, WDIE);
        let due = watchdog.next();
        assert_eq!(watchdog.advance(due), None);
        assert_eq!(watchdog.advance(due + 64 * MS), Some(due + 64 * MS));
    }
}
