//! Arithmetic between the server's clock and the local one.

/// A time of the server on the local clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Mapped {
    pub(crate) local_ns: u64,
    pub(crate) uncertainty_ns: u64,
}

/// `to - from` of two readings of a wrapping counter, as a number.
pub(crate) const fn difference(to: u64, from: u64) -> f64 {
    to.wrapping_sub(from).cast_signed() as f64
}

/// `base` moved by a number of nanoseconds, within the type's range.
pub(crate) fn offset_by(base: u64, ns: f64) -> u64 {
    // The conversion saturates.
    base.saturating_add_signed(libm::round(ns) as i64)
}
