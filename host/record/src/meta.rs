//! The metadata of a record.

use std::collections::BTreeMap;

/// The version of records that this crate writes and reads. It must match exactly.
pub const RECORD_VERSION: u32 = 12;

/// The circumstances under which a record was made.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Meta {
    /// The configuration used, as TOML.
    pub configuration: String,
    /// Versions by component, such as `singletrackd`.
    pub software: BTreeMap<String, String>,
    /// Version of the protocol between the computers.
    pub protocol_version: u16,
    /// Seed of the simulation, if there was one.
    pub seed: Option<u64>,
    /// The clocks when the record began.
    pub start: ClockMapping,
}

/// The same moment on two clocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClockMapping {
    /// On the host's monotonic clock, in ns.
    pub monotonic_ns: u64,
    /// On the wall clock, in ns since 1970.
    pub wall_ns: u64,
}

impl ClockMapping {
    /// Of a drive in virtual time, which has no time of day: 2000-01-01.
    pub const VIRTUAL: Self = Self {
        monotonic_ns: 0,
        wall_ns: 946_684_800_000_000_000,
    };

    /// The time of a wall clock that was not set since, at `monotonic_ns`.
    #[must_use]
    pub const fn wall_ns_at(&self, monotonic_ns: u64) -> u64 {
        if monotonic_ns >= self.monotonic_ns {
            self.wall_ns
                .saturating_add(monotonic_ns - self.monotonic_ns)
        } else {
            self.wall_ns
                .saturating_sub(self.monotonic_ns - monotonic_ns)
        }
    }
}
