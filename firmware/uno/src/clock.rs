//! The board's clock: microseconds since the start, wrapping.
//!
//! Timer 0 counts 4 µs, 250 of them to a tick of 1 ms; the interrupt at the
//! end of a tick belongs to the [`crate::supervisor`].

use crate::interrupts::{Masked, Shared, masked};
use crate::registers::{OCR0A, TCCR0A, TCCR0B, TCNT0, TIFR0, TIMSK0};

/// Time between two ticks, in µs.
const TICK_US: u32 = 1_000;
/// Prescaler 64 at 16 MHz.
const COUNT_US: u8 = 4;
const COUNTS_PER_TICK: u8 = 250;
const _: () = assert!(TICK_US == COUNT_US as u32 * COUNTS_PER_TICK as u32);

const WGM01: u8 = 1 << 1;
const CS01_CS00: u8 = 0b11;
const OCIE0A: u8 = 1 << 1;
const OCF0A: u8 = 1 << 1;

/// Time of the last tick.
static TICK_AT_US: Shared<u32> = Shared::new(0);

/// Starts the ticks.
pub(crate) fn start() {
    TCCR0A.write(WGM01);
    OCR0A.write(COUNTS_PER_TICK - 1);
    TIMSK0.write(OCIE0A);
    TCCR0B.write(CS01_CS00);
}

/// One tick later. Returns its time.
#[inline(always)]
pub(crate) fn tick(masked: Masked) -> u32 {
    let at_us = TICK_AT_US.get(masked).wrapping_add(TICK_US);
    TICK_AT_US.set(masked, at_us);
    at_us
}

/// What the clock is made of, as an interrupt can catch it in few cycles.
#[derive(Clone, Copy)]
pub(crate) struct Instant {
    tick_at_us: u32,
    counts: u8,
    flags: u8,
}

impl Instant {
    pub(crate) const ZERO: Self = Self {
        tick_at_us: 0,
        counts: 0,
        flags: 0,
    };

    #[inline(always)]
    pub(crate) fn now(masked: Masked) -> Self {
        Self {
            tick_at_us: TICK_AT_US.get(masked),
            counts: TCNT0.read(),
            // After the counter: a tick that ends in between is then known
            // from the counter's being near its end.
            flags: TIFR0.read(),
        }
    }

    /// In µs.
    pub(crate) fn us(self) -> u32 {
        let ended = self.flags & OCF0A != 0 && self.counts < COUNTS_PER_TICK / 2;
        let since_tick_us =
            u16::from(self.counts) * u16::from(COUNT_US) + if ended { TICK_US as u16 } else { 0 };
        self.tick_at_us.wrapping_add(since_tick_us.into())
    }
}

/// The board's time, in µs.
pub(crate) fn now_us() -> u32 {
    masked(Instant::now).us()
}
