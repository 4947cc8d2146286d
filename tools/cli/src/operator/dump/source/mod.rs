//! Where rows come from.

mod frames;
mod line;
mod live;
mod record;

use std::{
    fmt,
    fs::File,
    io::Read,
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use singletrack_record::Value;

pub use frames::Direction;
pub(super) use frames::{BROKEN, kinds};
pub(super) use line::Line;
pub(super) use live::Live;
pub(super) use record::Record;

use super::{DumpError, span::Span};

/// The longest time that a source waits for more.
const PATIENCE: Duration = Duration::from_millis(100);

/// Now, in ns since 1970; none if the wall clock is before that.
fn wall_ns() -> Option<u64> {
    let wall = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    u64::try_from(wall.as_nanos()).ok()
}

/// A row before its fields are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Row {
    /// Which of the source's kinds it is.
    pub(super) kind: usize,
    /// When it reached the host, in ns since the start; none before the first time
    /// is known.
    pub(super) time_ns: Option<i64>,
}

impl Row {
    /// When it reached the host, in seconds since the start.
    pub(super) fn time(&self) -> Value {
        self.time_ns
            .map_or(Value::Absent, |ns| Value::Float(ns as f64 / 1e9))
    }
}

/// What comes next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// A row, which can be read until the next is asked for.
    Row(Row),
    /// Nothing yet: [`Source::wait`] waits for more.
    Pending,
    /// Nothing any more.
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

    /// Replaces `values` with the fields of the row, in the order of its kind.
    fn read_values(&mut self, values: &mut Vec<Value>) -> Result<(), DumpError>;

    /// Adds the row to `json` as one object with all its fields.
    fn write_json(&mut self, json: &mut String) -> Result<(), DumpError>;

    /// How it ended.
    fn close(&self) -> Close;
}

/// The source that the command line names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// The running daemon.
    Live,
    /// A record.
    Record(PathBuf),
    /// A serial port.
    Serial(PathBuf),
    /// Bytes of the line, in a file.
    Raw(PathBuf),
    /// Bytes of the line, on standard input.
    Stdin,
}

impl fmt::Display for Place {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Live => formatter.write_str("live"),
            Self::Stdin => formatter.write_str("standard input"),
            Self::Record(path) | Self::Serial(path) | Self::Raw(path) => {
                path.display().fmt(formatter)
            }
        }
    }
}

/// What every MCAP file begins with.
const MCAP_MAGIC: [u8; 5] = *b"\x89MCAP";

impl Place {
    /// The source with this name.
    pub(super) fn of(path: &Path, raw: bool) -> Self {
        let name = path.to_string_lossy();
        if path.as_os_str() == "-" {
            return Self::Stdin;
        }
        if raw {
            return Self::Raw(path.to_owned());
        }
        if path.as_os_str() == "live" {
            return Self::Live;
        }
        if name.ends_with(".mcap") || name.ends_with(".mcap.part") {
            return Self::Record(path.to_owned());
        }
        let Ok(metadata) = path.metadata() else {
            // Opening a record reports best why it failed.
            return Self::Record(path.to_owned());
        };
        if metadata.file_type().is_char_device() {
            return Self::Serial(path.to_owned());
        }
        if !(metadata.is_file() || metadata.is_dir()) {
            // Of a pipe, what is looked at is gone.
            return Self::Raw(path.to_owned());
        }
        let mut magic = [0; MCAP_MAGIC.len()];
        let read = File::open(path).and_then(|mut file| file.read_exact(&mut magic));
        if metadata.is_dir() || (read.is_ok() && magic == MCAP_MAGIC) {
            Self::Record(path.to_owned())
        } else {
            Self::Raw(path.to_owned())
        }
    }
}
