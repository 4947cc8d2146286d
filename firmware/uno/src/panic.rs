//! Panic handler. No panic is known to be possible; if one occurs, the car stops.

use core::panic::PanicInfo;

use crate::{interrupts, kill_output, pulses};

/// Drops the ESC's supply, ends the pulses, which makes servo and ESC let go, and waits
/// for the watchdog.
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    interrupts::masked(|masked| {
        kill_output::set(masked, false);
        pulses::stop(masked);
    });
    interrupts::disable();
    loop {}
}
