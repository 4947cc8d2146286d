//! Cause of the processor's start, and the watchdog: it resets the processor if for 64 ms the main
//! loop hangs, or the pulse guard sets no pulses.
//!
//! The first instructions start the watchdog, so that it also covers
//! the initialisation.

#![allow(unsafe_code)]

use core::arch::{asm, global_asm};

use singletrack_protocol::ResetCause;

use crate::{interrupts::SharedByte, pulse_guard::Guarded, registers::GPIOR1};

// Runs before memory is initialised (r1 is zero; the other registers are unchanged)
// and leaves the flags in GPIOR1.
//
// The bootloader (Optiboot) clears MCUSR and passes its value in r2.
//
// After a watchdog reset the watchdog keeps running with 16 ms until WDRF is
// cleared; it is set to 64 ms: WDE and WDP1, within four cycles of WDCE.
global_asm!(
    ".section .init3, \"ax\", @progbits",
    "wdr",
    "in r24, 0x34", // MCUSR
    "out 0x34, r1",
    "tst r24",
    "brne 1f",
    "mov r24, r2",
    "1: out 0x2A, r24", // GPIOR1
    "ldi r24, 0x18",    // WDCE, WDE
    "ldi r25, 0x0A",    // WDE, WDP1
    "sts 0x60, r24",    // WDTCSR
    "sts 0x60, r25",
    ".text",
);

// A byte that no start clears.
global_asm!(
    ".section .noinit, \"aw\", @nobits",
    ".global reset_kept",
    "reset_kept: .skip 1",
    ".text",
);

unsafe extern "C" {
    /// [`KNOWN`] once a host has learned of the power-on. The port that it opens then resets the
    /// board again, which would hide it.
    #[link_name = "reset_kept"]
    safe static KEPT: SharedByte;
}

const KNOWN: u8 = 0xA5;

/// Notes that the host knows the cause of the start.
pub(crate) fn is_known() {
    KEPT.set(KNOWN);
}

const PORF: u8 = 1 << 0;
const EXTRF: u8 = 1 << 1;
const BORF: u8 = 1 << 2;
const WDRF: u8 = 1 << 3;
const NO_FLAGS: u8 = !(PORF | EXTRF | BORF | WDRF);

/// Cause of the processor's start. If several flags are set, the later resets
/// followed from the first: the bootloader exits by its watchdog after an external
/// reset. A power-on is the cause until a host knows of it.
pub(crate) fn cause() -> ResetCause {
    match GPIOR1.read() {
        // Not flags: the bootloader passes nothing.
        flags if flags & NO_FLAGS != 0 => ResetCause::Unknown,
        flags if flags & PORF != 0 => {
            KEPT.set(0);
            ResetCause::PowerOn
        }
        flags if flags & (EXTRF | WDRF) != 0 && KEPT.get() != KNOWN => ResetCause::PowerOn,
        flags if flags & BORF != 0 => ResetCause::BrownOut,
        flags if flags & EXTRF != 0 => ResetCause::External,
        flags if flags & WDRF != 0 => ResetCause::Watchdog,
        _ => ResetCause::Unknown,
    }
}

/// Only the main loop calls this, after a completed poll and with the proof that the pulse
/// guard works. A poll proves the main loop alone: frames of the host wake it without the
/// guard, whose timer repeats its last pulses.
pub(crate) fn feed(_: Guarded) {
    // SAFETY: only resets the watchdog's counter.
    unsafe { asm!("wdr", options(nomem, nostack, preserves_flags)) };
}
