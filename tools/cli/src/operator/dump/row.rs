//! The rows of a dump, and what gives them.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use singletrack_protocol::{ToBoard, ToHost};
use singletrack_record::{Entry, Value};

use super::DumpError;

/// The longest time that a source waits for more.
pub(super) const PATIENCE: Duration = Duration::from_millis(100);

/// Now, in ns since 1970; none if the wall clock is before that.
pub(super) fn wall_ns() -> Option<u64> {
    let wall = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    u64::try_from(wall.as_nanos()).ok()
}

/// A row before its message is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Row {
    /// The index of its kind.
    pub(super) kind: usize,
    /// When it reached the host, in ns since the start; none before the first time
    /// is known.
    pub(super) time_ns: Option<i64>,
}

/// The message of a row.
#[derive(Clone, Copy, Debug)]
pub(super) enum Message<'a> {
    /// An entry of a record or of the running daemon; a tick of a record is without its events.
    Entry(&'a Entry),
    /// What a stretch of bytes on the line holds.
    Frame(&'a Content),
}

/// The next step of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// A row, which can be read until the next step.
    Row(Row),
    /// Nothing yet: [`Source::wait`] waits for more.
    Pending,
    /// The source has ended.
    End,
}

/// How a source ended, with figures of the whole source.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Close {
    /// A note for standard error.
    pub(super) note: Option<String>,
    /// Bytes that came over the line.
    pub(super) line_bytes: Option<u64>,
    /// Rows that the source could not hand over in time.
    pub(super) missed: u64,
    /// Whether a record has not been finished.
    pub(super) unfinished: bool,
}

/// Gives rows, one after another.
pub(super) trait Source {
    /// When it starts, in ns since 1970 on the wall, if that is known.
    fn start_wall_ns(&self) -> Option<u64>;

    /// The times of its first and its last row, if they are known before it is read.
    fn span(&self) -> Option<Span> {
        None
    }

    /// Goes to the next row, without waiting.
    fn next(&mut self) -> Result<Next, DumpError>;

    /// Waits for more, but not for long.
    fn wait(&mut self) -> Result<(), DumpError>;

    /// Passes the message of the row to `take`.
    fn take_message(&mut self, take: &mut dyn FnMut(Message<'_>)) -> Result<(), DumpError>;

    /// Replaces `values` with the fields of the message, in the order of its kind.
    fn read_values(&mut self, values: &mut Vec<Value>) -> Result<(), DumpError>;

    /// Adds the entry to `json` as one object with all its fields. Frames have no such form.
    fn write_json(&mut self, json: &mut String) -> Result<(), DumpError> {
        self.take_message(&mut |message| {
            if let Message::Entry(entry) = message {
                entry.write_json(json);
            }
        })
    }

    /// How it ended.
    fn close(&self) -> Close;
}

/// What a stretch of bytes up to a zero holds.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Content {
    /// A message of the board.
    ToHost(ToHost),
    /// A message of the host.
    ToBoard(ToBoard),
    /// No frame.
    Broken(Broken),
}

/// Bytes that are not a frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Broken {
    /// Why, in a word.
    pub(super) reason: &'static str,
    /// Why, in a sentence.
    pub(super) detail: String,
    /// Its first bytes.
    pub(super) bytes: Vec<u8>,
}

/// The times of the entries of a record, in ns since its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Span {
    pub(super) first_ns: i64,
    pub(super) last_ns: i64,
    /// When the record starts, in ns since 1970.
    pub(super) start_wall_ns: u64,
}
