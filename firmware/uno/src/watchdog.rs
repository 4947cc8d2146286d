//! Resets the processor if for 64 ms the main loop hangs, or the pulse guard sets no
//! pulses.
//!
//! The first instructions start it, see [`crate::reset`], so that it also covers
//! the initialisation.
#![allow(unsafe_code)]

use core::arch::asm;

use crate::pulse_guard::Guarded;

/// Only the main loop calls this, after a completed poll and with the proof that the pulse
/// guard works. A poll proves the main loop alone: frames of the host wake it without the
/// guard, whose timer repeats its last pulses.
pub(crate) fn feed(_: Guarded) {
    // SAFETY: only resets the watchdog's counter.
    unsafe { asm!("wdr", options(nomem, nostack, preserves_flags)) };
}
