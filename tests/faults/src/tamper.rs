//! Planted bugs: what shows that a violation would be found.

use singletrack_core::config::Config;
use singletrack_record::TickRecord;
use singletrack_sim::PulseRecord;

/// Changes what the parts do, behind their backs. Does nothing by itself.
pub trait Tamper {
    /// What the host sends to the board at `now_us`.
    fn to_board(&mut self, now_us: u64, bytes: &mut Vec<u8>) {
        let _ = (now_us, bytes);
    }

    /// The configuration in force as the invariants see it; `number` is 1 for a daemon
    /// that has just started.
    fn configuration(&mut self, number: u32, config: &mut Config) {
        let _ = (number, config);
    }

    /// A frame of pulses as the invariants see it.
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        let _ = pulse;
    }

    /// A tick as the invariants see it.
    fn tick(&mut self, tick: &mut TickRecord) {
        let _ = tick;
    }

    /// Whether what a tick decides must follow from what it was told: not if
    /// [`Tamper::tick`] stands for a pilot that decides otherwise.
    fn is_replayed(&self) -> bool {
        true
    }
}

/// Nobody tampers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Untampered;

impl Tamper for Untampered {}
