//! A delay in ticks.

/// A delay in whole ticks and the rest, in s.
#[derive(Clone, Copy)]
pub(super) struct Delay {
    pub(super) ticks: usize,
    pub(super) late: f64,
}

impl Delay {
    pub(super) fn new(delay: f64, period: f64) -> Self {
        let ticks = (delay / period + 1e-9) as usize;
        Self {
            ticks,
            late: (delay - ticks as f64 * period).max(0.0),
        }
    }
}
