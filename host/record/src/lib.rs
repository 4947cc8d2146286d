//! The record of a drive: inputs and outputs of every tick, in a file that general
//! tools open and from which a replay gives the same outputs, bit for bit.
//!
//! A record is an MCAP file of ROS 2 messages (CDR, with their `ros2msg`
//! definitions): Foxglove, Lichtblick, PlotJuggler, rerun and the Python readers
//! open it without a plugin. Each kind of [`Entry`] is a [`Topic`] with its own
//! channel; the [`Meta`] is the file's metadata and, for the configuration, its
//! attachment.
//!
//! These messages hold everything. Beside them, the [`StandardTopic`]s hold the part of
//! an entry that ROS has standard types for, with which general tools show the moving
//! car. An [`Encoder`] makes both.
//!
//! - [`Recorder`] writes a record; [`RecorderThread`] runs one behind bounded rings.
//! - [`Reader`] reads a record, finished or not.
//! - [`recover`] repairs a truncated or damaged record.
//! - [`Entry::write_json`] and [`Entry::values`] give the fields of an entry for printing.
//!
//! Times in the messages are nanoseconds on the host's monotonic clock. The log and
//! publish times of the file are the same moments on the wall clock. The mapping between
//! the clocks is taken once, when the record begins, so setting the wall clock later has
//! no effect.

mod derive;
mod entry;
#[cfg(feature = "files")]
mod file;
mod message;
mod replay;
mod standard;
mod tick;
mod topic;
mod value;

pub use derive::{Encoder, Publication};
pub use entry::{
    ClockMapping, ConfigurationRecord, Drops, Entry, Level, Log, Meta, RECORD_VERSION,
    StatusRecord, TelemetryRecord, seconds_since,
};
#[cfg(feature = "files")]
pub use file::{
    Ending, FeedInput, FeedOutput, Finished, Reader, RecordError, Recorded, Recorder,
    RecorderThread, Recovery, feed, parse_record, part_path, put_in_place, recover, replace,
};
pub use replay::{Difference, Digest, Replay, ReplayError};
pub use standard::{BASE_FRAME, MAP_FRAME, ODOM_FRAME, StandardTopic};
pub use tick::{DriveWrite, LinkPhase, MAX_EVENTS, TickInput, TickOutput, TickRecord, tick_feed};
pub use topic::{Channel, Topic, UnknownTopic, write_json_object};
pub use value::Value;
