//! A value of the main loop at a fixed address.
//!
//! The processor reaches 64 bytes from a pointer, and everything at an address
//! that is known: the same code on the stack's frame is four times as large.
#![allow(unsafe_code)]

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

pub(crate) struct InPlace<T>(UnsafeCell<MaybeUninit<T>>);

// SAFETY: only whoever called `init` has access.
unsafe impl<T> Sync for InPlace<T> {}

impl<T> InPlace<T> {
    pub(crate) const fn new() -> Self {
        Self(UnsafeCell::new(MaybeUninit::uninit()))
    }

    /// Puts the value in its place.
    ///
    /// # Safety
    ///
    /// To be called once.
    #[inline(always)]
    pub(crate) unsafe fn init(&'static self, value: T) -> &'static mut T {
        // SAFETY: the first and only reference, as the caller promises.
        unsafe { (*self.0.get()).write(value) }
    }
}
