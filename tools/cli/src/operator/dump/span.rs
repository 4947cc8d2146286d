//! The time that a record covers.

use std::fmt;

use super::moment::Moment;

/// When the entries of a record are, in ns since its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Span {
    pub(super) first_ns: i64,
    pub(super) last_ns: i64,
    /// When the record starts, in ns since 1970.
    pub(super) start_wall_ns: u64,
}

impl fmt::Display for Span {
    /// The seconds, and the same on the wall.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let seconds = |ns: i64| ns as f64 / 1e9;
        let wall = |ns: i64| {
            let start_ns = i64::try_from(self.start_wall_ns).unwrap_or(i64::MAX);
            // To a millisecond, as the seconds.
            Moment::WallNs(start_ns.saturating_add(ns) / 1_000_000 * 1_000_000)
        };
        let Self {
            first_ns, last_ns, ..
        } = *self;
        write!(
            formatter,
            "{:.3} s to {:.3} s ({} to {})",
            seconds(first_ns),
            seconds(last_ns),
            wall(first_ns),
            wall(last_ns)
        )
    }
}
