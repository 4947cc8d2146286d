//! Pulses of the motor sensor (D2): their number, and the time of the newest.
//!
//! An edge costs 4 µs and precedes every other interrupt. Ringing could therefore
//! keep the pulse guard from running: after [`EDGES_PER_TICK`] the interrupt masks
//! itself until the next tick.
#![allow(unsafe_code)]

use singletrack_board::MotorPulses;

use crate::{
    clock::{Instant, SharedInstant},
    interrupts::{Masked, Shared, SharedByte, masked},
    registers::{EICRA, EIFR, EIMSK, PORTD},
};

/// Port D, bit 2.
const INT0: u8 = 1 << 2;
const INT0_RISES: u8 = 0b11;
const INT0_ENABLED: u8 = 1 << 0;

// Raw values from the interrupt; the main loop converts them.
static COUNT: Shared<u16> = Shared::new(0);
static NEWEST: SharedInstant = SharedInstant::new();

/// Edges accepted in a tick of 1 ms. (20 m/s with a pulse every 3 mm are 7; 16 take
/// 7 % of the processor.)
const EDGES_PER_TICK: u8 = 16;

/// Edges that are still accepted in this tick.
static EDGES_LEFT: SharedByte = SharedByte::new(EDGES_PER_TICK);
/// Ticks with more edges, wrapping.
static REFUSED: Shared<u16> = Shared::new(0);

/// The motor's sensor.
pub(crate) struct Motor {
    pulses: MotorPulses,
}

pub(crate) fn start() {
    // Hall sensors have an open collector.
    PORTD.set(INT0);
    EICRA.write(INT0_RISES);
    // Enabling the pull-up may have caused an edge.
    EIFR.write(INT0_ENABLED);
    EIMSK.write(INT0_ENABLED);
}

/// Accepts edges again; call it in every tick.
#[inline(always)]
pub(crate) fn tick(masked: Masked) {
    if EDGES_LEFT.get() == 0 {
        // The flag of an edge that came while the interrupt was masked.
        if EIFR.has(INT0_ENABLED) {
            EIFR.write(INT0_ENABLED);
            REFUSED.set(masked, REFUSED.get(masked).wrapping_add(1));
        }
        EIMSK.write(INT0_ENABLED);
    }
    EDGES_LEFT.set(EDGES_PER_TICK);
}

/// Ticks with more edges than are accepted, wrapping.
pub(crate) fn refused() -> u16 {
    masked(|masked| REFUSED.get(masked))
}

impl Motor {
    pub(crate) const fn new() -> Self {
        Self {
            pulses: MotorPulses {
                count: 0,
                last_edge_us: 0,
            },
        }
    }

    /// Call in every poll, at most 65 ms apart; returns the pulses so far.
    pub(crate) fn poll(&mut self, now_us: u32) -> MotorPulses {
        if masked(|masked| COUNT.get(masked)) != self.pulses.count {
            let (count, newest) = masked(|masked| (COUNT.get(masked), NEWEST.get(masked)));
            self.pulses = MotorPulses {
                count,
                last_edge_us: newest.near(now_us),
            };
        }
        self.pulses
    }
}

/// External interrupt 0.
// SAFETY: the name is that of the vector, and nothing else has it.
#[unsafe(no_mangle)]
extern "avr-interrupt" fn __vector_1() {
    // SAFETY: this is an interrupt handler.
    let masked = unsafe { Masked::assume() };
    NEWEST.set(masked, Instant::now(masked));
    COUNT.set(masked, COUNT.get(masked).wrapping_add(1));
    let left = EDGES_LEFT.get().wrapping_sub(1);
    EDGES_LEFT.set(left);
    if left == 0 {
        EIMSK.write(0);
    }
}
