//! Serial line to the host: 115200 baud, 8 data bits, no parity, one stop bit.

#![allow(unsafe_code)]

use singletrack_protocol::{MAX_FRAME_LENGTH, RECEIVE_BUFFER_LENGTH};

use crate::{
    interrupts::SharedByte,
    pulse_guard,
    registers::{UBRR0H, UBRR0L, UCSR0A, UCSR0B, UCSR0C, UDR0},
};

/// 16 MHz / 8 / (16 + 1) = 117,647 baud: 2.1 % fast, as on every UNO.
const DIVISOR: u8 = 16;

const TRANSMIT_BUFFER_LENGTH: usize = 128;
const _: () = assert!(TRANSMIT_BUFFER_LENGTH >= 2 * MAX_FRAME_LENGTH);

// UCSR0A
const FE0: u8 = 1 << 4;
const DOR0: u8 = 1 << 3;
const U2X0: u8 = 1 << 1;
// UCSR0B
const RXCIE0: u8 = 1 << 7;
const UDRIE0: u8 = 1 << 5;
const RXEN0: u8 = 1 << 4;
const TXEN0: u8 = 1 << 3;
const LISTENING: u8 = RXCIE0 | RXEN0 | TXEN0;
const SENDING: u8 = LISTENING | UDRIE0;
// UCSR0C
const UCSZ01_UCSZ00: u8 = 0b11 << 1;

static RECEIVED: Ring<RECEIVE_BUFFER_LENGTH> = Ring::new();
static TO_SEND: Ring<TRANSMIT_BUFFER_LENGTH> = Ring::new();
/// Not zero: a frame has ended that the main loop has not fetched.
static FRAME_ENDED: SharedByte = SharedByte::new(0);
/// Lost bytes, wrapping; the main loop reads it often enough.
static LOST: SharedByte = SharedByte::new(0);

pub(crate) fn start() {
    UBRR0H.write(0);
    UBRR0L.write(DIVISOR);
    UCSR0A.write(U2X0);
    UCSR0C.write(UCSZ01_UCSZ00);
    UCSR0B.write(LISTENING);
}

/// Whether a frame has ended since the last [`Receiver::receive`].
pub(crate) fn has_frame() -> bool {
    FRAME_ENDED.get() != 0
}

/// Whether at least the longest frame is waiting: the bytes may not be frames.
pub(crate) fn is_filling() -> bool {
    RECEIVED.used() >= MAX_FRAME_LENGTH as u8
}

/// The receiver, as the main loop sees it.
pub(crate) struct Receiver {
    lost: u16,
}

impl Receiver {
    pub(crate) const fn new() -> Self {
        Self { lost: 0 }
    }

    /// Moves received bytes to `buffer` and returns them; the rest stays for the
    /// next call.
    pub(crate) fn receive<'a>(&mut self, buffer: &'a mut [u8]) -> &'a [u8] {
        let new = LOST.get().wrapping_sub(self.lost as u8);
        self.lost = self.lost.wrapping_add(new.into());
        // First, so that a frame that ends from now on is noticed.
        FRAME_ENDED.set(0);
        let mut length = 0;
        for slot in buffer.iter_mut() {
            let Some(byte) = RECEIVED.take() else { break };
            *slot = byte;
            length += 1;
        }
        buffer.get(..length).unwrap_or_default()
    }

    /// Bytes lost since the start, wrapping: receiver or buffer overrun, or no stop
    /// bit.
    pub(crate) const fn bytes_lost(&self) -> u16 {
        self.lost
    }
}

/// Queues a whole frame, or nothing and returns `false` if there is no room.
#[inline(never)]
pub(crate) fn transmit(frame: &[u8]) -> bool {
    if !TO_SEND.put_all(frame) {
        return false;
    }
    // Written, not modified: the interrupt changes the same bit.
    UCSR0B.write(SENDING);
    true
}

/// Receive complete.
// SAFETY: the name is that of the vector, and nothing else has it.
#[unsafe(no_mangle)]
extern "avr-interrupt" fn __vector_18() {
    // The status first: reading the byte replaces it by the next one's.
    let status = UCSR0A.read();
    let byte = UDR0.read();
    if byte == 0 {
        FRAME_ENDED.set(1);
        pulse_guard::wake();
    }
    // DOR0: at least one byte before this one was lost.
    if status & DOR0 != 0 {
        LOST.set(LOST.get().wrapping_add(1));
    }
    if status & FE0 != 0 || !RECEIVED.put(byte) {
        LOST.set(LOST.get().wrapping_add(1));
    }
}

/// Transmit register empty.
// SAFETY: the name is that of the vector, and nothing else has it.
#[unsafe(no_mangle)]
extern "avr-interrupt" fn __vector_19() {
    if !TO_SEND.take_with(|byte| UDR0.write(byte)) {
        UCSR0B.write(LISTENING);
    }
}

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
    fn put(&self, byte: u8) -> bool {
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
    fn put_all(&self, bytes: &[u8]) -> bool {
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
    fn take_with(&self, sink: impl FnOnce(u8)) -> bool {
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
