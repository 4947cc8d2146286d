//! What the image and the program that counts its cycles have in common.

#![allow(unsafe_code)]

use core::cell::UnsafeCell;

/// A value of the main loop at a fixed address.
///
/// The processor addresses 64 bytes relative to a pointer, and any known address
/// directly: the same code with a stack frame is four times as large. Values known
/// at compile time need no initialisation code.
pub(crate) struct InPlace<T>(UnsafeCell<T>);

// SAFETY: only the caller of `take` has access, and there is one processor.
unsafe impl<T> Sync for InPlace<T> {}

impl<T> InPlace<T> {
    pub(crate) const fn new(value: T) -> Self {
        Self(UnsafeCell::new(value))
    }

    /// Returns the only reference to the value.
    ///
    /// # Safety
    ///
    /// Must be called only once.
    #[inline(always)]
    #[expect(clippy::mut_from_ref, reason = "the first and only reference")]
    pub(crate) unsafe fn take(&'static self) -> &'static mut T {
        // SAFETY: the first and only reference, as the caller promises.
        unsafe { &mut *self.0.get() }
    }
}

/// Runs `action` between the markers of section `number`, between which the simulator counts
/// cycles.
#[inline(always)]
pub(crate) fn measured<R>(number: u8, action: impl FnOnce() -> R) -> R {
    mark(number);
    let result = action();
    mark(0);
    result
}

#[inline(always)]
fn mark(number: u8) {
    const GPIOR0: *mut u8 = 0x3E as *mut u8;
    // SAFETY: a general-purpose register without a function.
    unsafe { GPIOR0.write_volatile(number) };
}

// Division, copying and filling from avr-gcc's libraries. They are written in assembly for this
// processor and take a third of the cycles and a tenth of the flash of Rust's portable versions.
// These libraries precede Rust's, so the linker uses them.
// SAFETY: declares no items.
#[link(name = "gcc")]
#[link(name = "c")]
unsafe extern "C" {}
