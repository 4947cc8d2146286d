//! A byte queue between the main loop and one interrupt.

use crate::interrupts::SharedByte;

/// A ring buffer with one producer and one consumer. All `N` bytes are usable.
///
/// The counters run freely and wrap at 256, which is a multiple of `N`.
pub(crate) struct Ring<const N: usize> {
    bytes: [SharedByte; N],
    put: SharedByte,
    taken: SharedByte,
}

impl<const N: usize> Ring<N> {
    pub(crate) const fn new() -> Self {
        const { assert!(N.is_power_of_two() && N <= 128) };
        Self {
            bytes: [const { SharedByte::new(0) }; N],
            put: SharedByte::new(0),
            taken: SharedByte::new(0),
        }
    }

    #[inline(always)]
    fn slot(&self, counter: u8) -> &SharedByte {
        // The compiler can prove that the index is in range.
        &self.bytes[usize::from(counter) % N]
    }

    /// Number of bytes in the queue.
    #[inline(always)]
    pub(crate) fn used(&self) -> u8 {
        self.put.get().wrapping_sub(self.taken.get())
    }

    /// Appends one byte; `false` if there is no room.
    #[inline(always)]
    pub(crate) fn put(&self, byte: u8) -> bool {
        let put = self.put.get();
        if put.wrapping_sub(self.taken.get()) >= N as u8 {
            return false;
        }
        self.slot(put).set(byte);
        // The byte before the counter that publishes it: both are volatile.
        self.put.set(put.wrapping_add(1));
        true
    }

    /// Appends all of `bytes`, or none and returns `false` if there is no room.
    #[inline(always)]
    pub(crate) fn put_all(&self, bytes: &[u8]) -> bool {
        let put = self.put.get();
        let used = self.used();
        if bytes.len() + usize::from(used) > N {
            return false;
        }
        // In two parts: up to the end of the buffer, and from its beginning.
        let (beginning, end) = self.bytes.split_at(usize::from(put) % N);
        for (slot, &byte) in end.iter().zip(bytes) {
            slot.set(byte);
        }
        let rest = bytes.get(end.len()..).unwrap_or_default();
        for (slot, &byte) in beginning.iter().zip(rest) {
            slot.set(byte);
        }
        self.put.set(put.wrapping_add(bytes.len() as u8));
        true
    }

    /// Removes the oldest byte.
    #[inline(always)]
    pub(crate) fn take(&self) -> Option<u8> {
        let taken = self.taken.get();
        if taken == self.put.get() {
            return None;
        }
        let byte = self.slot(taken).get();
        self.taken.set(taken.wrapping_add(1));
        Some(byte)
    }

    /// Passes the oldest byte to `sink`, if there is one. Returns whether more
    /// bytes follow.
    #[inline(always)]
    pub(crate) fn take_with(&self, sink: impl FnOnce(u8)) -> bool {
        let (taken, put) = (self.taken.get(), self.put.get());
        if taken == put {
            return false;
        }
        sink(self.slot(taken).get());
        let taken = taken.wrapping_add(1);
        self.taken.set(taken);
        taken != put
    }
}
