//! Planted bugs, which show that the invariants find violations.

use singletrack_core::config::Config;
use singletrack_pilot::Learned;
use singletrack_record::TickRecord;
use singletrack_sim::{PulseFilter, PulseRecord};

/// Hooks that change inputs and outputs of a drive. The default does nothing.
pub trait Tamper {
    /// Changes the configuration with which a daemon starts; the invariants judge by the
    /// one that it was given.
    fn host(&mut self, config: &mut Config) {
        let _ = config;
    }

    /// Changes the bytes that the host writes at `now_us`.
    fn written(&mut self, now_us: u64, bytes: &mut Vec<u8>) {
        let _ = (now_us, bytes);
    }

    /// Changes the bytes on the way from the host to the board at `now_us`.
    fn to_board(&mut self, now_us: u64, bytes: &mut Vec<u8>) {
        let _ = (now_us, bytes);
    }

    /// The configuration in force as the invariants see it; `number` is 1 for a daemon
    /// that has just started.
    fn configuration(&mut self, number: u32, config: &mut Config) {
        let _ = (number, config);
    }

    /// Changes the pulses on the pins of a native board, before car and invariants get
    /// them.
    fn pulse(&mut self, pulse: &mut PulseRecord) {
        let _ = pulse;
    }

    /// Changes the kill output of a native board.
    fn power(&mut self, on: &mut bool) {
        let _ = on;
    }

    /// Changes a tick before the invariants see it.
    fn tick(&mut self, tick: &mut TickRecord) {
        let _ = tick;
    }

    /// Changes the corrections that the pilot has learned, after the tick with this index, before
    /// the invariants see them.
    fn learned(&mut self, index: u64, learned: &mut Learned) {
        let _ = (index, learned);
    }

    /// Whether the output of a tick must follow from its inputs. False if
    /// [`Tamper::tick`] stands in for a faulty pilot.
    fn is_replayed(&self) -> bool {
        true
    }
}

/// The pins of a native board, tampered with.
pub(crate) struct TamperedPins<'a>(pub(crate) &'a mut dyn Tamper);

impl PulseFilter for TamperedPins<'_> {
    fn frame(&mut self, frame: &mut PulseRecord) {
        self.0.pulse(frame);
    }

    fn power(&mut self, on: &mut bool) {
        self.0.power(on);
    }
}

/// No planted bug.
#[derive(Clone, Copy, Debug, Default)]
pub struct Untampered;

impl Tamper for Untampered {}
