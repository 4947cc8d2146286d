//! The stop switch: normally closed, from D4 to ground. A wire that breaks
//! looks like a switch that opens.

use crate::registers::{PIND, PORTD};

/// Port D, bit 4.
const STOP: u8 = 1 << 4;

pub(crate) fn start() {
    PORTD.set(STOP);
}

pub(crate) fn is_open() -> bool {
    PIND.has(STOP)
}
