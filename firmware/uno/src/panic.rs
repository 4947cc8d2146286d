//! Panic handler. No panic is known to be possible; if one occurs, the car stops.

use core::panic::PanicInfo;

use crate::{interrupts, pulses};

/// Ends the pulses, which makes servo and ESC let go, and waits for the watchdog.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    interrupts::masked(pulses::stop);
    interrupts::disable();
    loop {}
}
