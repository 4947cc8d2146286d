//! A serial line in memory, paced at the baud rate, with configurable faults.

use std::collections::VecDeque;

use singletrack_statistics::Random;

/// Ten bits at 115200 baud.
const BYTE_NS: u64 = 86_806;

/// What goes wrong, for every byte.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Faults {
    pub(crate) corrupt: f64,
    pub(crate) drop: f64,
}

/// One direction.
pub(crate) struct Wire {
    noise: Random,
    pub(crate) faults: Faults,
    /// Bytes with the time at which they arrive.
    under_way: VecDeque<(u64, u8)>,
    free_at_ns: u64,
    /// While true, nothing comes out, and everything waits.
    pub(crate) stuck: bool,
}

impl Wire {
    pub(crate) fn new(seed: u64, faults: Faults) -> Self {
        Self {
            noise: Random::new(seed),
            faults,
            under_way: VecDeque::new(),
            free_at_ns: 0,
            stuck: false,
        }
    }

    pub(crate) fn put(&mut self, now_ns: u64, bytes: &[u8]) {
        self.free_at_ns = self.free_at_ns.max(now_ns);
        for &byte in bytes {
            self.free_at_ns += BYTE_NS;
            if self.noise.happens(self.faults.drop) {
                continue;
            }
            let damage = if self.noise.happens(self.faults.corrupt) {
                (self.noise.bits() % 255 + 1) as u8
            } else {
                0
            };
            self.under_way.push_back((self.free_at_ns, byte ^ damage));
        }
    }

    pub(crate) fn take(&mut self, now_ns: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        while !self.stuck
            && let Some(&(arrival_ns, byte)) = self.under_way.front()
            && arrival_ns <= now_ns
        {
            bytes.push(byte);
            self.under_way.pop_front();
        }
        bytes
    }

    pub(crate) fn clear(&mut self) {
        self.under_way.clear();
        self.free_at_ns = 0;
    }
}
