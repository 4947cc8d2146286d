//! The rows of a dump, and where they come from: a record, the running daemon, or the
//! [`Line`](super::line).

use std::{
    fmt,
    fs::File,
    io::Read,
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
    thread,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use singletrack_api::ClientError;
use singletrack_record::{Ending, Entry, Reader, Recorded, Topic, Value};
use singletrackd::monotonic_ns;

use super::DumpError;
use crate::operator::entries::{Entries, Heard};

/// The field that every row has beside its own: seconds since the start of the
/// record, of the capture, or of listening.
pub(super) const TIME: &str = "time_s";

/// A topic of a record, or a type of frame on the line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Kind {
    /// Its name on the command line and in JSON.
    pub(super) name: &'static str,
    /// The paths of its fields, in the order of its values. The last one is [`TIME`].
    pub(super) fields: Vec<String>,
    /// The fields that a table shows unless others are asked for.
    pub(super) brief: Vec<String>,
    /// Whether its rows are asked for.
    pub(super) chosen: bool,
}

/// The fields of telemetry that a table shows beside its time.
pub(super) const TELEMETRY: &str = "mode stop_cause last_sequence imu forward_acceleration_mm_s2 \
    left_acceleration_mm_s2 yaw_rate_mrad_s motor_speed_mm_s servo_us esc_us";
/// The fields of a tick that a table shows.
const TICK: &str = "tick mode reason held point.x_m point.y_m reference.position.x_m \
    reference.position.y_m estimate.yaw_rad estimate.speed_m_s actuation.steering_rad lateness_ns \
    capture_to_command_ns";
/// The fields of a pose that a table shows.
const POSE: &str = "frame_number receive_time_ns state rejected pose.x_m pose.y_m pose.yaw_rad \
    pose.mean_error_m pose.capture_time_ns";

impl Kind {
    /// A kind with these fields and [`TIME`]. A table shows the fields `brief`, which are separated
    /// by spaces; all if there are none.
    pub(super) fn new(name: &'static str, mut fields: Vec<String>, brief: &str) -> Self {
        let brief = match brief {
            "" => fields.clone(),
            brief => brief.split(' ').map(ToOwned::to_owned).collect(),
        };
        fields.push(TIME.to_owned());
        Self {
            name,
            fields,
            brief,
            chosen: false,
        }
    }

    /// The topics of a record, in the order of [`Topic::index`].
    pub(super) fn topics() -> Vec<Self> {
        let kind = |topic: Topic| {
            let brief = match topic {
                Topic::Tick => TICK,
                Topic::Telemetry => &format!("receive_time_ns {TELEMETRY}"),
                Topic::Pose => POSE,
                // The whole of it is a page of text.
                Topic::Configuration => "time_ns number",
                _ => "",
            };
            Self::new(topic.name(), topic.fields(), brief)
        };
        Topic::ALL.map(kind).to_vec()
    }

    /// The index of the field with this name among its values.
    pub(super) fn index(&self, name: &str) -> Option<usize> {
        self.fields.iter().position(|field| field == name)
    }

    /// The fields from the message, without [`TIME`].
    pub(super) fn own_fields(&self) -> &[String] {
        self.fields.split_last().map_or(&[], |(_, own)| own)
    }

    /// Whether it has this name; a topic is also named by its channel in a record.
    pub(super) fn is_named(&self, name: &str) -> bool {
        self.name == name.strip_prefix("/singletrack/").unwrap_or(name)
    }
}

/// Time between two looks at what the daemon sends.
const LIVE: Duration = Duration::from_millis(10);

/// The topics of the chosen kinds.
fn chosen(kinds: &[Kind]) -> Vec<Topic> {
    let topics = Topic::ALL.into_iter().zip(kinds);
    let chosen = topics.filter(|(_, kind)| kind.chosen);
    chosen.map(|(topic, _)| topic).collect()
}

/// A record, finished or not. For printing, its messages become text without an [`Entry`] between.
pub(super) struct Record {
    name: String,
    reader: Reader,
    follow: bool,
    start_wall_ns: u64,
}

impl Record {
    /// Opens a record to read the chosen kinds.
    pub(super) fn open(path: &Path, kinds: &[Kind], follow: bool) -> Result<Self, DumpError> {
        let reader = Reader::open(path)?.only(&chosen(kinds));
        Ok(Self {
            name: path.display().to_string(),
            start_wall_ns: reader.meta.start.wall_ns,
            reader,
            follow,
        })
    }

    fn is_unfinished(&self) -> bool {
        matches!(self.reader.ending, Some(Ending::Unfinished { .. }))
    }

    const fn since_start(&self, wall_ns: u64) -> i64 {
        wall_ns.wrapping_sub(self.start_wall_ns).cast_signed()
    }
}

impl Source for Record {
    fn times(&self) -> Times {
        let span = self.reader.span_wall_ns();
        Times {
            start_wall_ns: Some(self.start_wall_ns),
            span_ns: span.map(|span| span.map(|ns| self.since_start(ns))),
        }
    }

    fn next(&mut self) -> Result<Next, DumpError> {
        Ok(match self.reader.advance()? {
            Some(Recorded { topic, wall_ns }) => Next::Row(Row {
                kind: topic.index(),
                time_ns: Some(self.since_start(wall_ns)),
            }),
            None if self.follow && self.is_unfinished() => Next::Pending,
            None => Next::End,
        })
    }

    fn wait(&mut self) -> Result<(), DumpError> {
        thread::sleep(PATIENCE);
        Ok(())
    }

    fn take_message(&mut self, take: &mut dyn FnMut(Message<'_>)) -> Result<(), DumpError> {
        let take = |entry: &Entry| take(Message::Entry(entry));
        Ok(self.reader.read_entry(take)?)
    }

    fn read_values(&mut self, values: &mut Vec<Value>) -> Result<(), DumpError> {
        Ok(self.reader.read_values(values)?)
    }

    fn write_json(&mut self, json: &mut String) -> Result<(), DumpError> {
        Ok(self.reader.write_json(json)?)
    }

    fn close(&self) -> Close {
        let ending = self.reader.ending.filter(|_| self.is_unfinished());
        Close {
            note: ending.map(|ending| format!("{}: {ending}", self.name)),
            unfinished: self.is_unfinished(),
            ..Close::default()
        }
    }
}

/// The entries that the running daemon sends.
pub(super) struct Live {
    path: PathBuf,
    entries: Entries,
    entry: Option<Box<Entry>>,
    start_ns: u64,
    start_wall_ns: Option<u64>,
    missed: u64,
}

impl Live {
    /// Subscribes to the chosen kinds, and waits until the daemon agrees.
    pub(super) fn connect(path: &Path, kinds: &[Kind]) -> Result<Self, DumpError> {
        Ok(Self {
            path: path.to_owned(),
            entries: Entries::watch(path, chosen(kinds))?,
            entry: None,
            start_ns: monotonic_ns(),
            start_wall_ns: wall_ns(),
            missed: 0,
        })
    }
}

impl Source for Live {
    fn times(&self) -> Times {
        Times {
            start_wall_ns: self.start_wall_ns,
            span_ns: None,
        }
    }

    fn next(&mut self) -> Result<Next, DumpError> {
        loop {
            match self.entries.next(Duration::ZERO) {
                Ok(None) => return Ok(Next::Pending),
                Ok(Some(Heard::Entry(entry))) => {
                    let time_ns = entry.time_ns().wrapping_sub(self.start_ns);
                    let kind = self.entry.insert(entry).topic().index();
                    return Ok(Next::Row(Row {
                        kind,
                        time_ns: Some(time_ns.cast_signed()),
                    }));
                }
                Ok(Some(Heard::Missed(count))) => {
                    self.missed += count;
                    eprintln!(
                        "singletrack: {}: {count} entries of all topics missed: \
                         what is printed is not taken as fast as they come",
                        self.path.display()
                    );
                }
                Err(ClientError::Ended) => return Ok(Next::End),
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn wait(&mut self) -> Result<(), DumpError> {
        thread::sleep(LIVE);
        Ok(())
    }

    fn take_message(&mut self, take: &mut dyn FnMut(Message<'_>)) -> Result<(), DumpError> {
        if let Some(entry) = &self.entry {
            take(Message::Entry(entry));
        }
        Ok(())
    }

    fn read_values(&mut self, values: &mut Vec<Value>) -> Result<(), DumpError> {
        *values = self.entry.as_deref().map(Entry::values).unwrap_or_default();
        Ok(())
    }

    fn close(&self) -> Close {
        Close {
            missed: self.missed,
            ..Close::default()
        }
    }
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

/// The beginning of every MCAP file.
const MCAP_MAGIC: [u8; 5] = *b"\x89MCAP";

impl Place {
    /// The source with this name.
    pub(super) fn of(path: &Path) -> Self {
        let name = path.to_string_lossy();
        if path.as_os_str() == "-" {
            return Self::Stdin;
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
    /// Bytes on the line that are no frame: why, in a word.
    Broken(&'static str),
    /// A frame that no record has.
    Other,
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
    fn times(&self) -> Times;

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

/// What is known of the times of a source before it is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Times {
    /// When it starts, in ns since 1970 on the wall.
    pub(super) start_wall_ns: Option<u64>,
    /// The times of its first and its last row, in ns since its start.
    pub(super) span_ns: Option<[i64; 2]>,
}
