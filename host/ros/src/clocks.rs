//! The clocks: stamps of ROS are on the wall clock, those of the daemon on `CLOCK_MONOTONIC`.

use std::time::{SystemTime, UNIX_EPOCH};

use rustix::time::{ClockId, clock_gettime};

const SECOND_NS: i128 = 1_000_000_000;

/// Both clocks at one moment, in ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Now {
    /// `CLOCK_MONOTONIC`.
    pub(crate) monotonic: i128,
    /// The wall clock, since 1970.
    pub(crate) wall: i128,
}

impl Now {
    pub(crate) fn read() -> Self {
        let monotonic = clock_gettime(ClockId::Monotonic);
        let wall = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |since| since.as_nanos());
        Self {
            // The fields have 32 bits on the Odroid.
            #[allow(clippy::useless_conversion, reason = "the type depends on the target")]
            monotonic: i128::from(monotonic.tv_sec) * SECOND_NS + i128::from(monotonic.tv_nsec),
            wall: i128::try_from(wall).unwrap_or(i128::MAX),
        }
    }

    /// The time of `CLOCK_MONOTONIC` at `wall` of the wall clock.
    pub(crate) const fn monotonic_at(&self, wall: i128) -> i128 {
        self.monotonic + (wall - self.wall)
    }

    /// How far the wall clock is ahead of another moment of both clocks, in s.
    pub(crate) const fn wall_step_s(&self, other: Self) -> f64 {
        ((self.wall - other.wall) - (self.monotonic - other.monotonic)) as f64 * 1e-9
    }
}
