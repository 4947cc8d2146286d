//! What the daemon says, how it is configured, and what it could not record.

use super::{code::Code, message};
use crate::{ConfigurationRecord, Drops, Level, Log};

message! {
    /// A line of the log.
    LogMessage as "Log" {
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
    ConfigurationMessage as "Configuration" {
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
    DropsMessage as "Drops" {
        /// When they were counted, in ns of the host's monotonic clock.
        time_ns: u64,
        /// How many since the record began.
        entries: u64,
    }
}

impl From<&Log> for LogMessage {
    fn from(log: &Log) -> Self {
        Self {
            time_ns: log.time_ns,
            level: Code(log.level),
            text: log.text.clone(),
        }
    }
}

impl From<LogMessage> for Log {
    fn from(message: LogMessage) -> Self {
        Self {
            time_ns: message.time_ns,
            level: message.level.0,
            text: message.text,
        }
    }
}

impl From<&ConfigurationRecord> for ConfigurationMessage {
    fn from(record: &ConfigurationRecord) -> Self {
        Self {
            time_ns: record.time_ns,
            number: record.number,
            toml: record.toml.clone(),
        }
    }
}

impl From<ConfigurationMessage> for ConfigurationRecord {
    fn from(message: ConfigurationMessage) -> Self {
        Self {
            time_ns: message.time_ns,
            number: message.number,
            toml: message.toml,
        }
    }
}

impl From<&Drops> for DropsMessage {
    fn from(drops: &Drops) -> Self {
        Self {
            time_ns: drops.time_ns,
            entries: drops.entries,
        }
    }
}

impl From<DropsMessage> for Drops {
    fn from(message: DropsMessage) -> Self {
        Self {
            time_ns: message.time_ns,
            entries: message.entries,
        }
    }
}
