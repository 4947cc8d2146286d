//! The daemon's log and configuration, and what it could not record.

use super::{
    code::Code,
    declare::{fields, message},
};
use crate::{ConfigurationRecord, Drops, Level, Log};

message! {
    /// A line of the log.
    LogMessage as "Log" of Log {
        /// When it was logged, in ns of the host's monotonic clock.
        time_ns: u64,
        /// How much it matters.
        level: Code<Level>,
        /// What it says.
        text: String,
    }
}

message! {
    /// Another configuration is in force.
    ConfigurationMessage as "Configuration" of ConfigurationRecord {
        /// When that was known, in ns of the host's monotonic clock.
        time_ns: u64,
        /// The number that a tick's event names it by; that of the start has 1.
        number: u32,
        /// The whole of it, as TOML.
        toml: String,
    }
}

message! {
    /// Messages that did not reach the record, because the writer was behind.
    DropsMessage as "Drops" of Drops {
        /// When they were counted, in ns of the host's monotonic clock.
        time_ns: u64,
        /// How many since the record began.
        entries: u64,
    }
}
