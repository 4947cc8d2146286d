//! Data shared by the main loop and the interrupts, and critical sections.
//!
//! A byte is stored in a [`SharedByte`]: the processor accesses it in one
//! instruction. A longer value is stored in a [`Shared`], which requires a proof
//! that interrupts are masked.
#![allow(unsafe_code)]

use core::{arch::asm, cell::UnsafeCell};

/// Proof that interrupts are masked.
#[derive(Clone, Copy)]
pub(crate) struct Masked(());

impl Masked {
    /// The proof for an interrupt handler.
    ///
    /// # Safety
    ///
    /// Interrupts must be masked, as in an interrupt handler.
    pub(crate) const unsafe fn assume() -> Self {
        Self(())
    }
}

/// Runs `action` with interrupts masked, and restores the mask.
///
/// Keep it short: it delays all interrupts, and a byte on the line is lost after
/// 87 µs.
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

/// Enables interrupts.
pub(crate) fn enable() {
    // SAFETY: all shared data is in a `SharedByte` or a `Shared`.
    unsafe { asm!("sei") };
}

/// Disables interrupts.
pub(crate) fn disable() {
    // SAFETY: masking interrupts is always sound.
    unsafe { asm!("cli") };
}

/// Enables interrupts and sleeps until one occurs.
///
/// The instruction after `sei` is executed before any interrupt, so a pending
/// interrupt still ends the sleep. (simavr serves it one instruction later than the
/// processor; the `nop` prevents that it is masked again.)
pub(crate) fn enable_and_sleep() {
    // SAFETY: as for `enable`.
    unsafe { asm!("sei", "sleep", "nop") };
}

/// A byte shared by the main loop and interrupts.
///
/// (`AtomicU8` would mask interrupts around every access.)
#[repr(transparent)]
pub(crate) struct SharedByte(UnsafeCell<u8>);

// SAFETY: there is one processor, and it reads or writes a byte in one instruction.
unsafe impl Sync for SharedByte {}

impl SharedByte {
    pub(crate) const fn new(value: u8) -> Self {
        Self(UnsafeCell::new(value))
    }

    #[inline(always)]
    pub(crate) fn get(&self) -> u8 {
        // SAFETY: see `Sync`; no reference escapes. Volatile: read and
        // written exactly in program order.
        unsafe { self.0.get().read_volatile() }
    }

    #[inline(always)]
    pub(crate) fn set(&self, value: u8) {
        // SAFETY: as for `get`.
        unsafe { self.0.get().write_volatile(value) };
    }
}

/// A value of several bytes shared by the main loop and interrupts.
pub(crate) struct Shared<T>(UnsafeCell<T>);

// SAFETY: there is one processor, and every access holds a proof that interrupts
// are masked.
unsafe impl<T: Copy> Sync for Shared<T> {}

impl<T: Copy> Shared<T> {
    pub(crate) const fn new(value: T) -> Self {
        Self(UnsafeCell::new(value))
    }

    #[inline(always)]
    pub(crate) fn get(&self, _: Masked) -> T {
        // SAFETY: see `Sync`; no reference escapes.
        unsafe { self.0.get().read() }
    }

    #[inline(always)]
    pub(crate) fn set(&self, _: Masked, value: T) {
        // SAFETY: see `Sync`; no reference escapes.
        unsafe { self.0.get().write(value) };
    }
}
