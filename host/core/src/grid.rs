//! The grid of the ticks: absolute deadlines. Missed ones are skipped, not caught up.

/// The place of a tick on the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// The deadline of the tick.
    pub scheduled_ns: u64,
    /// When the thread woke up.
    pub start_ns: u64,
    /// The number of deadlines skipped just before this one.
    pub skipped: u32,
}

/// The deadlines of the ticks, a period apart.
#[derive(Clone, Copy, Debug)]
pub struct Grid {
    next_ns: u64,
    period_ns: u64,
    /// Deadlines that passed during the last tick.
    overrun: u64,
}

impl Grid {
    /// A grid with its first deadline a period after `now_ns`.
    #[must_use]
    pub const fn new(now_ns: u64, period_ns: u64) -> Self {
        Self {
            next_ns: now_ns.saturating_add(period_ns),
            period_ns,
            overrun: 0,
        }
    }

    /// The next deadline.
    #[must_use]
    pub const fn next_ns(&self) -> u64 {
        self.next_ns
    }

    /// Moves all future deadlines by `by_ns`.
    pub const fn slide(&mut self, by_ns: i64) {
        self.next_ns = self.next_ns.saturating_add_signed(by_ns);
    }

    /// A tick ended at `now_ns`: the deadlines that passed during it are skipped.
    pub fn leave(&mut self, now_ns: u64) {
        if now_ns > self.next_ns {
            self.overrun = (now_ns - self.next_ns) / self.period_ns + 1;
            self.next_ns += self.overrun * self.period_ns;
        }
    }

    /// The slot of a thread that woke up at `now_ns`: the last deadline that has passed.
    /// Earlier ones are skipped.
    pub fn enter(&mut self, now_ns: u64) -> Slot {
        let skipped = now_ns.saturating_sub(self.next_ns) / self.period_ns;
        let scheduled_ns = self.next_ns + skipped * self.period_ns;
        self.next_ns = scheduled_ns + self.period_ns;
        let skipped = skipped + core::mem::take(&mut self.overrun);
        Slot {
            scheduled_ns,
            start_ns: now_ns,
            skipped: u32::try_from(skipped).unwrap_or(u32::MAX),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_that_overruns_deadlines_skips_them() {
        let mut grid = Grid::new(1_000, 100);
        grid.enter(1_100);
        grid.leave(1_190);
        assert_eq!(grid.next_ns, 1_200);
        grid.enter(1_200);
        grid.leave(1_510);
        assert_eq!(grid.next_ns, 1_600);
        let after = grid.enter(1_601);
        assert_eq!((after.scheduled_ns, after.skipped), (1_600, 3));
        grid.leave(1_650);
        assert_eq!(grid.enter(1_700).skipped, 0);
    }

    #[test]
    fn a_thread_that_wakes_late_skips_deadlines_and_keeps_the_grid() {
        let mut grid = Grid::new(1_000, 100);
        let on_time = grid.enter(1_103);
        assert_eq!((on_time.scheduled_ns, on_time.skipped), (1_100, 0));
        let late = grid.enter(1_299);
        assert_eq!((late.scheduled_ns, late.skipped), (1_200, 0));
        let overrun = grid.enter(1_650);
        assert_eq!((overrun.scheduled_ns, overrun.skipped), (1_600, 3));
        assert_eq!(grid.next_ns, 1_700);
        let stalled = grid.enter(1_000_000_050);
        assert_eq!(stalled.scheduled_ns, 1_000_000_000);
    }
}
