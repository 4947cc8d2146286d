//! The part of a record that has been replayed.

use std::time::Duration;

use singletrack_record::TickRecord;

/// What has been replayed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Span {
    pub(super) ticks: u64,
    first_ns: u64,
    last_ns: u64,
}

impl Span {
    pub(super) fn add(&mut self, tick: &TickRecord) {
        if self.ticks == 0 {
            self.first_ns = tick.start_ns;
        }
        self.ticks += 1;
        self.last_ns = tick.start_ns;
    }

    /// From its beginning to `tick`, in s.
    pub(super) fn seconds_to(&self, tick: &TickRecord) -> f64 {
        let first_ns = if self.ticks == 0 {
            tick.start_ns
        } else {
            self.first_ns
        };
        tick.start_ns.saturating_sub(first_ns) as f64 * 1e-9
    }

    pub(super) fn pace(&self, took: Duration) -> String {
        let seconds = self.last_ns.saturating_sub(self.first_ns) as f64 * 1e-9;
        let took = took.as_secs_f64();
        format!(
            "{seconds:.2} s replayed in {took:.3} s: {:.0} times real time",
            seconds / took
        )
    }
}
