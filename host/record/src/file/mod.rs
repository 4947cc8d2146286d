//! Records in files: writer, reader and recovery.

mod chunk;
mod container;
mod error;
mod feed;
mod metadata;
mod parse;
mod reader;
mod recorder;
mod recover;
mod span;

pub use container::part_path;
pub use error::RecordError;
pub use feed::{FeedInput, FeedOutput, RecorderThread, feed};
pub use reader::{Ending, Reader, Recorded};
pub use recorder::{Finished, Recorder};
pub use recover::{Recovery, recover};
