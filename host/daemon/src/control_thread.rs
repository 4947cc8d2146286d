//! The control thread: absolute deadlines, in real time if the system lets it.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::Thread,
};

use singletrack_core::{LineCounters, control_loop::ControlLoop, grid::Grid, line::Line};

use crate::clock::{monotonic_ns, sleep_until};

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
        sleep_until(grid.next_ns());
        control.tick(grid.enter(monotonic_ns()), &monotonic_ns);
        signs.ticks.fetch_add(1, Ordering::Relaxed);
        collector.unpark();
        grid.slide(control.slide_ns());
    }
    control.counters()
}

/// Raised when the control thread ends, however it does.
pub(crate) struct Ended(pub(crate) Arc<AtomicBool>);

impl Drop for Ended {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}
