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
    /// Ticks done. Whoever judges whether the thread lives relies on it and on the time of the last
    /// one, and not on records, which may be late or dropped.
    pub(crate) ticks: Arc<AtomicU64>,
    /// When the last tick was done, in ns of the monotonic clock; 0 before the first.
    pub(crate) ticked_ns: Arc<AtomicU64>,
    /// Set when the thread has ended, by a panic too.
    pub(crate) ended: Arc<AtomicBool>,
    /// Asks the thread to end at once, without stopping the car.
    pub(crate) abort: Arc<AtomicBool>,
}

/// A control thread whose last tick is older is stuck.
const TICK_TIMEOUT: Duration = Duration::from_millis(500);

impl ControlThreadState {
    /// A tick was done at `now_ns`.
    pub(crate) fn ticked(&self, now_ns: u64) {
        self.ticked_ns.store(now_ns, Ordering::Relaxed);
        self.ticks.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether the thread has ticked, and has not for [`TICK_TIMEOUT`] at `now_ns`.
    pub(crate) fn is_stuck(&self, now_ns: u64) -> bool {
        let ticked_ns = self.ticked_ns.load(Ordering::Relaxed);
        let silent_ns = now_ns.saturating_sub(ticked_ns);
        ticked_ns > 0 && silent_ns > TICK_TIMEOUT.as_nanos() as u64
    }
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
        state.ticked(monotonic_ns());
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_is_stuck_half_a_second_after_its_last_tick() {
        let state = ControlThreadState::default();
        assert!(!state.is_stuck(u64::MAX), "before the first tick");
        state.ticked(1_000);
        assert!(!state.is_stuck(500_001_000));
        assert!(state.is_stuck(500_001_001));
        state.ticked(2_000);
        assert!(!state.is_stuck(500_001_001));
    }
}
