//! The grid of the ticks: absolute deadlines. Missed ones are skipped, not caught up.

/// The place of a tick on the grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// When the tick was due: at its deadline, or earlier, when a frame arrived.
    pub scheduled_ns: u64,
    /// The deadline of the tick.
    pub deadline_ns: u64,
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

    /// The slot of a thread that woke up at `now_ns` for a tick that was due at `due_ns`, the
    /// next deadline or earlier. If later deadlines have passed too, the tick is that of the last
    /// of them, and the others are skipped.
    pub fn enter(&mut self, now_ns: u64, due_ns: u64) -> Slot {
        let skipped = now_ns.saturating_sub(self.next_ns) / self.period_ns;
        let deadline_ns = self.next_ns + skipped * self.period_ns;
        self.next_ns = deadline_ns + self.period_ns;
        let scheduled_ns = if skipped == 0 {
            due_ns.min(deadline_ns)
        } else {
            deadline_ns
        };
        let skipped = skipped + core::mem::take(&mut self.overrun);
        Slot {
            scheduled_ns,
            deadline_ns,
            start_ns: now_ns,
            skipped: u32::try_from(skipped).unwrap_or(u32::MAX),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Enters without a frame.
    fn enter(grid: &mut Grid, now_ns: u64) -> Slot {
        let due_ns = grid.next_ns();
        grid.enter(now_ns, due_ns)
    }

    #[test]
    fn a_tick_that_overruns_deadlines_skips_them() {
        let mut grid = Grid::new(1_000, 100);
        enter(&mut grid, 1_100);
        grid.leave(1_190);
        assert_eq!(grid.next_ns, 1_200);
        enter(&mut grid, 1_200);
        grid.leave(1_510);
        assert_eq!(grid.next_ns, 1_600);
        let after = enter(&mut grid, 1_601);
        assert_eq!((after.scheduled_ns, after.skipped), (1_600, 3));
        grid.leave(1_650);
        assert_eq!(enter(&mut grid, 1_700).skipped, 0);
    }

    #[test]
    fn a_thread_that_wakes_late_skips_deadlines_and_keeps_the_grid() {
        let mut grid = Grid::new(1_000, 100);
        let on_time = enter(&mut grid, 1_103);
        assert_eq!((on_time.scheduled_ns, on_time.skipped), (1_100, 0));
        let late = enter(&mut grid, 1_299);
        assert_eq!((late.scheduled_ns, late.skipped), (1_200, 0));
        let overrun = enter(&mut grid, 1_650);
        assert_eq!((overrun.scheduled_ns, overrun.skipped), (1_600, 3));
        assert_eq!(grid.next_ns, 1_700);
        let stalled = enter(&mut grid, 1_000_000_050);
        assert_eq!(stalled.scheduled_ns, 1_000_000_000);
    }

    #[test]
    fn a_tick_that_begins_before_its_deadline_keeps_the_grid() {
        let mut grid = Grid::new(1_000, 100);
        let early = grid.enter(1_081, 1_080);
        assert_eq!((early.scheduled_ns, early.deadline_ns), (1_080, 1_100));
        assert_eq!((early.skipped, grid.next_ns), (0, 1_200));
        // Due early, but the thread woke up after later deadlines.
        let late = grid.enter(1_450, 1_190);
        assert_eq!((late.scheduled_ns, late.deadline_ns), (1_400, 1_400));
        assert_eq!((late.skipped, grid.next_ns), (2, 1_500));
    }
}
