//! The pulses of servo (D9) and ESC (D10), made by timer 1 by itself.
//!
//! Every 20 ms both pins rise together and each falls when its compare value is
//! reached. No software has a part in an edge.

use crate::clock;
use crate::interrupts::Masked;
use crate::registers::{DDRB, ICR1, OCR1A, OCR1B, PORTB, TCCR1A, TCCR1B, TCNT1};

/// Prescaler 8 at 16 MHz.
const COUNTS_PER_US: u16 = 2;
/// Counts from one pulse to the next, 20 ms.
const PERIOD: u16 = 40_000;

/// No pulse is ever shorter or longer, in µs: what servos and ESCs understand.
const SHORTEST_US: u16 = 800;
const LONGEST_US: u16 = 2_200;

/// The part of a period past both pulses, and not near the next ones, as the high
/// byte of the counter.
const BETWEEN_PULSES: core::ops::Range<u8> = 18..155;
const _: () = assert!(BETWEEN_PULSES.start as u16 * 256 > Width::from_us(LONGEST_US).0);
const _: () = assert!((BETWEEN_PULSES.end as u16 + 1) * 256 <= PERIOD);

/// The end of it, in which the next pulses are decided: a tick or two long. What
/// was written earlier would be of no effect.
///
/// The timer takes new values over at the end of a period only; but servo
/// pulses are also switched on and off here, and that must not cut one.
const DECISION: core::ops::Range<u8> = 143..BETWEEN_PULSES.end;
const _: () =
    assert!((DECISION.end - DECISION.start) as u32 * 256 >= COUNTS_PER_US as u32 * clock::TICK_US);

// Port B, bits 1 and 2
const OC1A: u8 = 1 << 1;
const OC1B: u8 = 1 << 2;

// Mode 14: up to ICR1, pins set at zero and cleared at the compare value.
const COM1A1: u8 = 1 << 7;
const COM1B1: u8 = 1 << 5;
const WGM11: u8 = 1 << 1;
const WGM13_WGM12: u8 = 0b11 << 3;
const CS11: u8 = 1 << 1;

const ESC_ONLY: u8 = COM1B1 | WGM11;
const SERVO_AND_ESC: u8 = COM1A1 | ESC_ONLY;

/// The width of a pulse as the timer wants it: the pin falls one count after
/// the compare value.
#[derive(Clone, Copy)]
pub(crate) struct Width(u16);

impl Width {
    pub(crate) const fn from_us(us: u16) -> Self {
        Self((us * COUNTS_PER_US).wrapping_sub(1))
    }

    /// Between the limits, whatever memory or main loop have come to.
    #[inline(always)]
    fn compare_value(self) -> u16 {
        self.0
            .max(const { Self::from_us(SHORTEST_US).0 })
            .min(const { Self::from_us(LONGEST_US).0 })
    }
}

/// Begins with a whole ESC pulse, and no servo pulses.
pub(crate) fn start(masked: Masked, esc: Width) {
    // Low as long as the timer does not have the pins.
    PORTB.clear(OC1A | OC1B);
    DDRB.set(OC1A | OC1B);
    // Not buffered until the mode is set.
    OCR1A.write(masked, esc.compare_value());
    OCR1B.write(masked, esc.compare_value());
    // The timer takes its period only in a mode that has one: before, and with
    // the clock still off.
    TCCR1A.write(ESC_ONLY);
    TCCR1B.write(WGM13_WGM12);
    ICR1.write(masked, PERIOD - 1);
    // The pin rises when the counter passes from the end to zero.
    TCNT1.write(masked, PERIOD - 2);
    TCCR1B.write(WGM13_WGM12 | CS11);
}

/// Whether it is time to say what the next pulses are to be.
#[inline(always)]
pub(crate) fn are_due(masked: Masked) -> bool {
    DECISION.contains(&TCNT1.read_high(masked))
}

/// The ESC's pulses from the next period on; to be called while they
/// [`are_due`].
#[inline(always)]
pub(crate) fn show_esc(masked: Masked, width: Width) {
    OCR1B.write(masked, width.compare_value());
}

/// The servo's pulses from the next period on, or none; to be called while
/// they [`are_due`].
#[inline(always)]
pub(crate) fn show_servo(masked: Masked, width: Option<Width>) {
    if let Some(width) = width {
        OCR1A.write(masked, width.compare_value());
        TCCR1A.write(SERVO_AND_ESC);
    } else {
        TCCR1A.write(ESC_ONLY);
    }
}

/// No more pulses, after the ones that may be going on. Takes up to 2.5 ms.
pub(crate) fn stop(masked: Masked) {
    while !BETWEEN_PULSES.contains(&TCNT1.read_high(masked)) {}
    TCCR1A.write(WGM11);
}
