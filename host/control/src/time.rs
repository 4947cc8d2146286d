//! Times on the host's monotonic clock.

/// Nanoseconds on the host's monotonic clock (`CLOCK_MONOTONIC` in the daemon,
/// simulated time elsewhere).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Time(pub u64);

/// Nanoseconds in a second.
const SECOND: f64 = 1e9;

impl Time {
    /// Seconds from `earlier` to this time; negative if `earlier` is later.
    #[must_use]
    pub fn seconds_since(self, earlier: Self) -> f64 {
        if self >= earlier {
            (self.0 - earlier.0) as f64 / SECOND
        } else {
            -((earlier.0 - self.0) as f64 / SECOND)
        }
    }

    /// The time `seconds` after this one, rounded down to a nanosecond.
    #[must_use]
    pub fn after(self, seconds: f64) -> Self {
        Self(self.0.saturating_add((seconds * SECOND) as u64))
    }

    /// The time `seconds` before this one, but not before the clock's zero.
    #[must_use]
    pub fn before(self, seconds: f64) -> Self {
        Self(self.0.saturating_sub((seconds * SECOND) as u64))
    }
}
