//! The stop switch: normally closed, from D4 to ground. A broken wire acts like an
//! open switch.

use crate::registers::{PIND, PORTD};

/// Port D, bit 4.
const STOP: u8 = 1 << 4;

pub(crate) fn start() {
    PORTD.set(STOP);
}

pub(crate) fn is_open() -> bool {
    PIND.has(STOP)
}
