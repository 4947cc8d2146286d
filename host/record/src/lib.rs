//! The record of a drive: what every tick saw and did, in a file that opens in
//! the tools labs already use, and that a replay can start from bit for bit.
//!
//! A record is an MCAP file of ROS 2 messages (CDR, with their `ros2msg`
//! definitions): Foxglove, Lichtblick, PlotJuggler, rerun and the Python readers
//! open it without a plugin. Each kind of [`Entry`] is a [`Topic`] with its own
//! channel; the [`Meta`] is the file's metadata and, for the configuration, its
//! attachment.
//!
//! Beside these, which hold everything, each entry is there as messages of ROS's
//! standard types as far as there are some for it, under the [`StandardTopic`]s:
//! general tools then show the car move. An [`Encoder`] makes both.
//!
//! - [`Recorder`] writes, [`RecorderThread`] does so behind bounded rings.
//! - [`Reader`] reads, unfinished files as well.
//! - [`recover`] makes a complete file of an unfinished or damaged one.
//! - [`Entry::write_json`] and [`Entry::values`] show an entry.
//!
//! Times in the messages are nanoseconds on the host's monotonic clock. The
//! file's log and publish times are the same moments on the wall clock, by the
//! one mapping taken when the record began: setting the clock changes nothing.

mod batch;
mod cdr;
mod channel;
mod chunk;
mod container;
mod encoder;
mod entry;
mod error;
mod feed;
mod json;
mod message;
mod meta;
mod reader;
mod recorder;
mod recover;
mod replay;
mod standard;
mod tick;
mod tick_feed;
mod topic;
mod value;

pub use batch::{EncodeError, Publication};
pub use channel::Channel;
pub use container::part_path;
pub use encoder::Encoder;
pub use entry::{ConfigurationRecord, Drops, Entry, Level, Log, StatusRecord, TelemetryRecord};
pub use error::RecordError;
pub use feed::{FeedInput, FeedOutput, RecorderThread, feed};
pub use json::{NotAnEntry, Shown, write_json_object};
pub use meta::{ClockMapping, Meta, RECORD_VERSION};
pub use reader::{Ending, Reader, Recorded};
pub use recorder::{Finished, Recorder};
pub use recover::{Recovery, recover};
pub use replay::{Difference, Replay, ReplayError};
pub use standard::{BASE_FRAME, StandardTopic, WORLD_FRAME};
pub use tick::{DriveWrite, LinkPhase, MAX_EVENTS, TickRecord};
pub use tick_feed::{TickInput, TickOutput, tick_feed};
pub use topic::{Topic, UnknownTopic};
pub use value::Value;
