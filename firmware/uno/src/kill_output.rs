//! The kill output (D7): high while the ESC has its supply. A pull-down holds it
//! low while the pin floats.

use crate::{
    interrupts::Masked,
    registers::{DDRD, PORTD},
};

/// Port D, bit 7.
const KILL: u8 = 1 << 7;

pub(crate) fn start(_: Masked) {
    PORTD.clear(KILL);
    DDRD.set(KILL);
}

/// Holds the supply, or drops it.
#[inline(always)]
pub(crate) fn set(_: Masked, on: bool) {
    if on {
        PORTD.set(KILL);
    } else {
        PORTD.clear(KILL);
    }
}
