//! Values of the main loop at fixed addresses.
//!
//! The processor addresses 64 bytes relative to a pointer, and any known address
//! directly: the same code with a stack frame is four times as large. Values known
//! at compile time need no initialisation code.
#![allow(unsafe_code)]

use core::cell::UnsafeCell;

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
