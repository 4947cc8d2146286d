//! The board's clock: microseconds since the start, wrapping.
//!
//! Timer 0 counts steps of 4 µs, 250 of them in a tick of 1 ms. The pulse guard's
//! interrupt handles the end of a tick.

use crate::{
    interrupts::{Masked, Shared, SharedByte, masked},
    registers::{OCR0A, TCCR0A, TCCR0B, TCNT0, TIFR0, TIMSK0},
};

/// Time between two ticks, in µs.
pub(crate) const TICK_US: u32 = 1_000;
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

/// Advances the clock by one tick.
#[inline(always)]
pub(crate) fn tick(masked: Masked) {
    TICK_AT_US.set(masked, TICK_AT_US.get(masked).wrapping_add(TICK_US));
}

/// The raw clock, which an interrupt can read in few cycles.
#[derive(Clone, Copy)]
pub(crate) struct Instant {
    /// The lower half of the time of the last tick.
    tick_at_us: u16,
    counts: u8,
    flags: u8,
}

impl Instant {
    #[inline(always)]
    pub(crate) fn now(masked: Masked) -> Self {
        Self {
            tick_at_us: TICK_AT_US.get(masked) as u16,
            counts: TCNT0.read(),
            // Read after the counter: if a tick ends in between, the counter shows
            // it by being near its end.
            flags: TIFR0.read(),
        }
    }

    /// Time since the last processed tick, in µs.
    fn since_tick_us(self) -> u16 {
        let ended = self.flags & OCF0A != 0 && self.counts < COUNTS_PER_TICK / 2;
        let tick_us = if ended { TICK_US as u16 } else { 0 };
        u16::from(self.counts) * u16::from(COUNT_US) + tick_us
    }

    /// Board time, in µs, of an instant in the 65 ms before `now_us` or the
    /// millisecond after it.
    pub(crate) fn near(self, now_us: u32) -> u32 {
        const FUTURE_US: u16 = TICK_US as u16;
        let us = self.tick_at_us.wrapping_add(self.since_tick_us());
        let age_us = (now_us as u16).wrapping_add(FUTURE_US).wrapping_sub(us);
        now_us
            .wrapping_add(FUTURE_US.into())
            .wrapping_sub(age_us.into())
    }
}

/// An instant shared by an interrupt and the main loop. (Separate fields, because
/// the compiler would assemble one structure with 32-bit shifts.)
pub(crate) struct SharedInstant {
    tick_at_us: Shared<u16>,
    counts: SharedByte,
    flags: SharedByte,
}

impl SharedInstant {
    pub(crate) const fn new() -> Self {
        Self {
            tick_at_us: Shared::new(0),
            counts: SharedByte::new(0),
            flags: SharedByte::new(0),
        }
    }

    #[inline(always)]
    pub(crate) fn get(&self, masked: Masked) -> Instant {
        Instant {
            tick_at_us: self.tick_at_us.get(masked),
            counts: self.counts.get(),
            flags: self.flags.get(),
        }
    }

    #[inline(always)]
    pub(crate) fn set(&self, masked: Masked, instant: Instant) {
        self.tick_at_us.set(masked, instant.tick_at_us);
        self.counts.set(instant.counts);
        self.flags.set(instant.flags);
    }
}

/// Board time of the last tick, in µs, for work that follows ticks: a finer clock
/// would sometimes be a few µs early and delay the work by a whole round.
pub(crate) fn tick_us() -> u32 {
    masked(|masked| TICK_AT_US.get(masked))
}

/// Board time, in µs.
pub(crate) fn now_us() -> u32 {
    let (tick_at_us, now) = masked(|masked| (TICK_AT_US.get(masked), Instant::now(masked)));
    tick_at_us.wrapping_add(now.since_tick_us().into())
}
