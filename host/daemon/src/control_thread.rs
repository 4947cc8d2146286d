//! The control thread: one tick per absolute deadline, or sooner if a frame arrives, with
//! real-time scheduling if the system grants it.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, Thread},
    time::Duration,
};

use singletrack_core::{LineCounters, control_loop::ControlLoop, grid::Grid, line::Line};

use crate::clock::{monotonic_ns, sleep_until};

/// Flags that the control thread shares with the others.
#[derive(Clone, Debug, Default)]
pub(crate) struct ControlThreadState {
    /// Ticks done. The watchdog relies on it, and not on records, which may be dropped.
    pub(crate) ticks: Arc<AtomicU64>,
    /// Set when the thread has ended, by a panic too.
    pub(crate) ended: Arc<AtomicBool>,
    /// Asks the thread to end at once, without stopping the car.
    pub(crate) abort: Arc<AtomicBool>,
}

/// Runs until the loop is done or `state.abort` is set. Wakes `collector` after every
/// tick.
pub(crate) fn run<L: Line>(
    mut control: ControlLoop<L>,
    period_ns: u64,
    state: &ControlThreadState,
    collector: &Thread,
) -> LineCounters {
    let mut grid = Grid::new(monotonic_ns(), period_ns);
    while !control.is_done() && !state.abort.load(Ordering::Relaxed) {
        wait(&mut control, &grid);
        control.wake_up(&mut grid, &monotonic_ns);
        state.ticks.fetch_add(1, Ordering::Relaxed);
        collector.unpark();
    }
    control.counters()
}

/// Waits until the next tick is due. The receiver of the cameras unparks the thread.
fn wait<L: Line>(control: &mut ControlLoop<L>, grid: &Grid) {
    sleep_until(control.opens_ns(grid));
    loop {
        let left_ns = control.due_ns(grid).saturating_sub(monotonic_ns());
        if left_ns == 0 {
            return;
        }
        thread::park_timeout(Duration::from_nanos(left_ns));
    }
}

/// Sets the flag when it is dropped: when the control thread returns or panics.
pub(crate) struct SetOnDrop(pub(crate) Arc<AtomicBool>);

impl Drop for SetOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}
