//! The zero of the times at which something happens to a car.

/// Zero of all keys `..._at_s` and `..._from_s`; unknown until a drive has begun.
///
/// A drive does not begin at simulation time zero: bootloader, ESC and estimator come
/// first. Times in a configuration count from its beginning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Epoch(Option<u64>);

impl Default for Epoch {
    /// The start of the simulation.
    fn default() -> Self {
        Self(Some(0))
    }
}

impl Epoch {
    pub(crate) const fn new(epoch_us: Option<u64>) -> Self {
        Self(epoch_us)
    }

    /// Time since zero, in s; `None` before it.
    pub(crate) fn elapsed_s(self, now_us: u64) -> Option<f64> {
        Some(now_us.checked_sub(self.0?)? as f64 * 1e-6)
    }

    /// Whether a time has come.
    pub(crate) fn has_come(self, at_s: Option<f64>, now_us: u64) -> bool {
        at_s.is_some_and(|at_s| self.elapsed_s(now_us).is_some_and(|now_s| now_s >= at_s))
    }

    /// Whether now lies in the window from `from_s` for `for_ms`.
    pub(crate) fn is_within(self, from_s: Option<f64>, for_ms: f64, now_us: u64) -> bool {
        let end_s = from_s.map(|from_s| from_s + for_ms * 1e-3);
        self.has_come(from_s, now_us) && !self.has_come(end_s, now_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_count_from_the_epoch_and_nothing_happens_without_one() {
        let epoch = Epoch::new(Some(3_000_000));
        assert!(!epoch.has_come(Some(0.0), 2_999_999));
        assert!(epoch.has_come(Some(0.0), 3_000_000));
        assert!(!epoch.has_come(Some(2.0), 4_999_999));
        assert!(epoch.has_come(Some(2.0), 5_000_000));
        assert!(!epoch.has_come(None, 9_000_000));
        assert!(!Epoch::new(None).has_come(Some(0.0), 9_000_000));
        let within = |now_us| epoch.is_within(Some(1.0), 500.0, now_us);
        assert!(!within(3_999_999) && within(4_000_000));
        assert!(within(4_499_999) && !within(4_500_000));
    }
}
