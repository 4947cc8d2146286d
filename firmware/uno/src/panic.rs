//! Nothing here can panic as far as is known; if it does, the car stops.

use core::panic::PanicInfo;

use crate::interrupts;
use crate::pulses;

/// Ends the pulses, without which servo and ESC let go, and waits for the watchdog.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    interrupts::masked(pulses::stop);
    interrupts::disable();
    loop {}
}
