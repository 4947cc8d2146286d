//! A queue of bytes between the main loop and one interrupt.

use core::sync::atomic::{AtomicU8, Ordering::Relaxed};
use core::sync::atomic::{Ordering, compiler_fence};

/// One side only puts, the other only takes. All of `N` bytes can be used.
///
/// The counters run freely and wrap at 256, of which `N` is a divisor.
pub(crate) struct Ring<const N: usize> {
    bytes: [AtomicU8; N],
    put: AtomicU8,
    taken: AtomicU8,
}

impl<const N: usize> Ring<N> {
    pub(crate) const fn new() -> Self {
        const { assert!(N.is_power_of_two() && N <= 128) };
        Self {
            bytes: [const { AtomicU8::new(0) }; N],
            put: AtomicU8::new(0),
            taken: AtomicU8::new(0),
        }
    }

    #[inline(always)]
    fn slot(&self, counter: u8) -> &AtomicU8 {
        // The compiler sees that the index is in range.
        &self.bytes[usize::from(counter) % N]
    }

    /// How many bytes can be put now.
    #[inline(always)]
    pub(crate) fn room(&self) -> u8 {
        let used = self
            .put
            .load(Relaxed)
            .wrapping_sub(self.taken.load(Relaxed));
        (N as u8).wrapping_sub(used)
    }

    /// Puts one byte; `false` if there is no room.
    #[inline(always)]
    pub(crate) fn put(&self, byte: u8) -> bool {
        let put = self.put.load(Relaxed);
        if put.wrapping_sub(self.taken.load(Relaxed)) >= N as u8 {
            return false;
        }
        self.slot(put).store(byte, Relaxed);
        // The byte before the counter that tells of it.
        compiler_fence(Ordering::Release);
        self.put.store(put.wrapping_add(1), Relaxed);
        true
    }

    /// Takes the oldest byte.
    #[inline(always)]
    pub(crate) fn take(&self) -> Option<u8> {
        let taken = self.taken.load(Relaxed);
        if taken == self.put.load(Relaxed) {
            return None;
        }
        compiler_fence(Ordering::Acquire);
        let byte = self.slot(taken).load(Relaxed);
        compiler_fence(Ordering::Release);
        self.taken.store(taken.wrapping_add(1), Relaxed);
        Some(byte)
    }

    #[inline(always)]
    pub(crate) fn is_empty(&self) -> bool {
        self.put.load(Relaxed) == self.taken.load(Relaxed)
    }
}
