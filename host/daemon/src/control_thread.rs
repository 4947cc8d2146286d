//! The control thread: absolute deadlines, in real time if the system lets it.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::Thread,
};

use crate::{
    clock::{monotonic_ns, sleep_until},
    control_loop::{ControlLoop, Slot},
    report::LineCounters,
    serial_port::Line,
};

/// What others see of the control thread.
#[derive(Clone, Debug, Default)]
pub(crate) struct Signs {
    /// Ticks that it has done: proof that it lives, whatever becomes of records.
    pub(crate) ticks: Arc<AtomicU64>,
    /// It has ended, however it did.
    pub(crate) ended: Arc<AtomicBool>,
    /// Others ask it to end at once.
    pub(crate) give_up: Arc<AtomicBool>,
}

/// Runs until the loop is done, or it is to give up; `collector` is woken after
/// every tick.
pub(crate) fn run<L: Line>(
    mut control: ControlLoop<L>,
    period_ns: u64,
    signs: &Signs,
    collector: &Thread,
) -> LineCounters {
    let mut grid = Grid::new(monotonic_ns(), period_ns);
    while !control.is_done() && !signs.give_up.load(Ordering::Relaxed) {
        grid.leave(monotonic_ns());
        sleep_until(grid.next_ns);
        control.tick(grid.enter(monotonic_ns()), &monotonic_ns);
        signs.ticks.fetch_add(1, Ordering::Relaxed);
        collector.unpark();
        grid.slide(control.slide_ns());
    }
    control.counters()
}

/// The points in time that ticks belong to.
#[derive(Clone, Copy, Debug)]
struct Grid {
    next_ns: u64,
    period_ns: u64,
    /// Points that the last tick ran over.
    overrun: u64,
}

impl Grid {
    const fn new(now_ns: u64, period_ns: u64) -> Self {
        Self {
            next_ns: now_ns.saturating_add(period_ns),
            period_ns,
            overrun: 0,
        }
    }

    /// Moves all points to come.
    const fn slide(&mut self, by_ns: i64) {
        self.next_ns = self.next_ns.saturating_add_signed(by_ns);
    }

    /// A tick has ended: the points that it ran over are skipped.
    fn leave(&mut self, now_ns: u64) {
        if now_ns > self.next_ns {
            self.overrun = (now_ns - self.next_ns) / self.period_ns + 1;
            self.next_ns += self.overrun * self.period_ns;
        }
    }

    /// The point that a thread which woke up now belongs to: the last one that
    /// is past. Those before it are skipped; nothing is made up for.
    fn enter(&mut self, now_ns: u64) -> Slot {
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

/// Raised when the control thread ends, however it does.
pub(crate) struct Ended(pub(crate) Arc<AtomicBool>);

impl Drop for Ended {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_that_runs_over_the_next_one_skips_it() {
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
    fn a_thread_that_wakes_late_skips_what_it_missed_and_keeps_the_grid() {
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
