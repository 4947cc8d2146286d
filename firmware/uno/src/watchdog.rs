//! Resets the processor if the main loop hangs for 64 ms.
//!
//! The first instructions start it, see [`crate::reset`], so that it also covers
//! the initialisation.
#![allow(unsafe_code)]

use core::arch::asm;

/// Only the main loop calls this, once per completed poll.
pub(crate) fn feed() {
    // SAFETY: only resets the watchdog's counter.
    unsafe { asm!("wdr", options(nomem, nostack, preserves_flags)) };
}
