//! Resets the processor when the main loop has not come round for 64 ms.
//!
//! It is started by the first instructions, see [`crate::reset`], so that it
//! also watches the way to the main loop.
#![allow(unsafe_code)]

use core::arch::asm;

/// To be called by the main loop, once per completed poll, and by nobody else.
pub(crate) fn feed() {
    // SAFETY: resets the watchdog's counter, nothing else.
    unsafe { asm!("wdr", options(nomem, nostack, preserves_flags)) };
}
