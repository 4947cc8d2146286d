//! The record of a drive: what every tick saw and did, in a file.

mod entry;
mod tick;

pub use entry::{Drops, Entry, Level, Log, StatusRecord, TelemetryRecord};
pub use tick::{DriveWrite, LinkPhase, MAX_EVENTS, TickRecord};
