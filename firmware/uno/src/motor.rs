//! Pulses of the motor sensor (D2): their number, and the time of the newest.
#![allow(unsafe_code)]

use singletrack_board::MotorPulses;

use crate::{
    clock::{Instant, SharedInstant},
    interrupts::{Masked, Shared, masked},
    registers::{EICRA, EIFR, EIMSK, PORTD},
};

/// Port D, bit 2.
const INT0: u8 = 1 << 2;
const INT0_RISES: u8 = 0b11;
const INT0_ENABLED: u8 = 1 << 0;

// Raw values from the interrupt; the main loop converts them.
static COUNT: Shared<u16> = Shared::new(0);
static NEWEST: SharedInstant = SharedInstant::new();

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
}
