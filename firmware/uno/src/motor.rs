//! The pulses of the motor's sensor (D2): counted, the newest one dated.
#![allow(unsafe_code)]

use singletrack_board::MotorPulses;

use crate::clock::Instant;
use crate::interrupts::{Masked, Shared, masked};
use crate::registers::{EICRA, EIFR, EIMSK, PORTD};

/// Port D, bit 2.
const INT0: u8 = 1 << 2;
const INT0_RISES: u8 = 0b11;
const INT0_ENABLED: u8 = 1 << 0;

/// As the interrupt catches it; what it means is worked out by the main loop.
#[derive(Clone, Copy)]
struct Capture {
    count: u16,
    newest: Instant,
}

static CAPTURE: Shared<Capture> = Shared::new(Capture {
    count: 0,
    newest: Instant::ZERO,
});

pub(crate) fn start() {
    // Hall sensors have an open collector.
    PORTD.set(INT0);
    EICRA.write(INT0_RISES);
    // The pull-up may just have made an edge.
    EIFR.write(INT0_ENABLED);
    EIMSK.write(INT0_ENABLED);
}

/// The pulses so far.
pub(crate) fn pulses() -> MotorPulses {
    let Capture { count, newest } = masked(|masked| CAPTURE.get(masked));
    MotorPulses {
        count,
        last_edge_us: newest.us(),
    }
}

/// External interrupt 0.
// SAFETY: the name is that of the vector, and nothing else has it.
#[unsafe(no_mangle)]
extern "avr-interrupt" fn __vector_1() {
    // SAFETY: this is an interrupt handler.
    let masked = unsafe { Masked::assume() };
    let newest = Instant::now(masked);
    let count = CAPTURE.get(masked).count.wrapping_add(1);
    CAPTURE.set(masked, Capture { count, newest });
}
