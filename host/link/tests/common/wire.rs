//! A serial line in memory, paced at the baud rate, with configurable faults.

use std::collections::VecDeque;

/// Ten bits at 115200 baud.
const BYTE_NS: u64 = 86_806;

/// `SplitMix64`: the same faults on every run.
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(crate) fn happens(&mut self, probability: f64) -> bool {
        ((self.next() >> 11) as f64) < probability * (1_u64 << 53) as f64
    }
}

/// What goes wrong, for every byte.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Faults {
    pub(crate) corrupt: f64,
    pub(crate) drop: f64,
}

/// One direction.
pub(crate) struct Wire {
    noise: Noise,
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
            noise: Noise(seed),
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
                (self.noise.next() % 255 + 1) as u8
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
