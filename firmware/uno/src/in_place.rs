//! A value of the main loop at a fixed address.
//!
//! The processor reaches 64 bytes from a pointer, and everything at an address
//! that is known: the same code on the stack's frame is four times as large.
//! And what is known when the image is compiled needs no code to put it there.
#![allow(unsafe_code)]

use core::cell::UnsafeCell;

pub(crate) struct InPlace<T>(UnsafeCell<T>);

// SAFETY: only whoever called `take` has access, and there is one processor.
unsafe impl<T> Sync for InPlace<T> {}

impl<T> InPlace<T> {
    pub(crate) const fn new(value: T) -> Self {
        Self(UnsafeCell::new(value))
    }

    /// The value.
    ///
    /// # Safety
    ///
    /// To be called once.
    #[inline(always)]
    #[expect(clippy::mut_from_ref, reason = "the first and only reference")]
    pub(crate) unsafe fn take(&'static self) -> &'static mut T {
        // SAFETY: the first and only reference, as the caller promises.
        unsafe { &mut *self.0.get() }
    }
}
