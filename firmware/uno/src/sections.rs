//! Markers between which the simulator counts cycles.
#![allow(unsafe_code)]

/// Runs `action` between the markers of section `number`.
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
