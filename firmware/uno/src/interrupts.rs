//! What the main loop and the interrupts share, and how they keep out of each
//! other's way.
//!
//! A byte goes into a [`SharedByte`]: the processor reads or writes it in one
//! instruction. A longer value goes into a [`Shared`], which asks for the proof
//! that no interrupt can come between its bytes.
#![allow(unsafe_code)]

use core::arch::asm;
use core::cell::UnsafeCell;

/// Proof that interrupts are masked.
#[derive(Clone, Copy)]
pub(crate) struct Masked(());

impl Masked {
    /// The proof, for a handler.
    ///
    /// # Safety
    ///
    /// Only where interrupts are masked, such as in an interrupt handler.
    pub(crate) const unsafe fn assume() -> Self {
        Self(())
    }
}

/// Runs `action` with interrupts masked, and restores the mask.
///
/// Keep it short: every interrupt waits, and a byte on the line waits 87 µs at most.
#[inline(always)]
pub(crate) fn masked<R>(action: impl FnOnce(Masked) -> R) -> R {
    let status: u8;
    // SAFETY: reading SREG and masking interrupts has no effect on memory. Not
    // `nomem`: the compiler must not move shared accesses out of the section.
    unsafe { asm!("in {}, 0x3F", "cli", out(reg) status) };
    let result = action(Masked(()));
    // SAFETY: restores SREG as it was, with its interrupt bit.
    unsafe { asm!("out 0x3F, {}", in(reg) status) };
    result
}

/// Lets interrupts come from now on.
pub(crate) fn enable() {
    // SAFETY: everything shared is in a `SharedByte` or a `Shared`.
    unsafe { asm!("sei") };
}

/// Masks interrupts for good.
pub(crate) fn disable() {
    // SAFETY: masking interrupts is always sound.
    unsafe { asm!("cli") };
}

/// Lets interrupts come and sleeps until one has.
///
/// The instruction after `sei` is executed before any interrupt: one that
/// came since the mask was set still ends the sleep. (simavr serves it an
/// instruction later than the processor does: the `nop`, lest it be masked again.)
pub(crate) fn enable_and_sleep() {
    // SAFETY: as for `enable`.
    unsafe { asm!("sei", "sleep", "nop") };
}

/// A byte, shared between main loop and interrupts.
///
/// (`AtomicU8` would do, but masks interrupts around every access.)
pub(crate) struct SharedByte(UnsafeCell<u8>);

// SAFETY: there is one processor, and it reads or writes a byte in one instruction.
unsafe impl Sync for SharedByte {}

impl SharedByte {
    pub(crate) const fn new(value: u8) -> Self {
        Self(UnsafeCell::new(value))
    }

    #[inline(always)]
    pub(crate) fn get(&self) -> u8 {
        // SAFETY: see `Sync`; no reference ever leaves. Volatile: read and
        // written when the program says so, in that order.
        unsafe { self.0.get().read_volatile() }
    }

    #[inline(always)]
    pub(crate) fn set(&self, value: u8) {
        // SAFETY: as for `get`.
        unsafe { self.0.get().write_volatile(value) };
    }
}

/// A value of several bytes, shared between main loop and interrupts.
pub(crate) struct Shared<T>(UnsafeCell<T>);

// SAFETY: there is one processor, and every access holds the proof that
// nothing interrupts it.
unsafe impl<T: Copy> Sync for Shared<T> {}

impl<T: Copy> Shared<T> {
    pub(crate) const fn new(value: T) -> Self {
        Self(UnsafeCell::new(value))
    }

    #[inline(always)]
    pub(crate) fn get(&self, _: Masked) -> T {
        // SAFETY: see `Sync`; no reference ever leaves.
        unsafe { self.0.get().read() }
    }

    #[inline(always)]
    pub(crate) fn set(&self, _: Masked, value: T) {
        // SAFETY: see `Sync`; no reference ever leaves.
        unsafe { self.0.get().write(value) };
    }
}
