//! The rows of a dump, and where they come from: a record, the running daemon, or the
//! [`Line`](super::line).

use std::{
    fs::File,
    io::Read,
    os::unix::fs::FileTypeExt,
    path::{Path, PathBuf},
    task::Poll,
    thread,
    time::Duration,
};

use jiff::Timestamp;
use singletrack_api::ClientError;
use singletrack_protocol::ToHost;
use singletrack_record::{
    ClockMapping, Ending, Entry, Reader, Recorded, Topic, Value, write_json_object,
};
use singletrackd::monotonic_ns;

use super::DumpArgs;
use crate::{
    Result,
    operator::entries::{Entries, Heard},
};

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

    /// The name of this field, as long as the kind, and its index.
    pub(super) fn field(&self, name: &str) -> Option<(&str, usize)> {
        let at = self.index(name)?;
        Some((self.fields.get(at)?, at))
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

/// The topics of the chosen kinds.
fn chosen(kinds: &[Kind]) -> Vec<Topic> {
    let topics = Topic::ALL.into_iter().zip(kinds);
    let chosen = topics.filter(|(_, kind)| kind.chosen);
    chosen.map(|(topic, _)| topic).collect()
}

/// A record, finished or not.
pub(super) struct Record {
    reader: Reader,
    follow: bool,
}

impl Record {
    /// Opens a record to read the chosen kinds.
    pub(super) fn open(path: &Path, kinds: &[Kind], follow: bool) -> Result<Self> {
        let reader = Reader::open(path)?.only(&chosen(kinds));
        Ok(Self { reader, follow })
    }

    const fn since_start(&self, wall_ns: u64) -> i64 {
        let start = self.reader.meta.start;
        wall_ns.wrapping_sub(start.wall_ns).cast_signed()
    }
}

impl Source for Record {
    fn about(&self) -> About {
        let unfinished = |ending: &Ending| matches!(ending, Ending::Unfinished { .. });
        let ending = self.reader.ending.filter(unfinished);
        let span = self.reader.span_wall_ns();
        About {
            start: Some(self.reader.meta.start),
            span_ns: span.map(|span| span.map(|ns| self.since_start(ns))),
            is_unfinished: ending.is_some(),
            note: ending.map(|ending| ending.to_string()),
            ..About::default()
        }
    }

    fn next(&mut self) -> Next<'_> {
        Ok(match self.reader.advance()? {
            Some(Recorded { topic, wall_ns }) => Poll::Ready(Some(Row {
                kind: topic.index(),
                time_ns: Some(self.since_start(wall_ns)),
                message: Message::Recorded(&mut self.reader),
            })),
            None if self.follow && self.about().is_unfinished => Poll::Pending,
            None => Poll::Ready(None),
        })
    }
}

/// The entries that the running daemon sends.
pub(super) struct Live {
    path: PathBuf,
    entries: Entries,
    start: ClockMapping,
    missed: u64,
}

impl Live {
    /// Subscribes to the chosen kinds, and waits until the daemon agrees.
    pub(super) fn connect(path: &Path, kinds: &[Kind]) -> Result<Self> {
        Ok(Self {
            path: path.to_owned(),
            entries: Entries::watch(path, chosen(kinds))?,
            start: now(),
            missed: 0,
        })
    }
}

impl Source for Live {
    fn about(&self) -> About {
        About {
            start: Some(self.start),
            missed: self.missed,
            ..About::default()
        }
    }

    fn next(&mut self) -> Next<'_> {
        loop {
            match self.entries.next(Duration::ZERO) {
                Ok(None) => return Ok(Poll::Pending),
                Ok(Some(Heard::Entry(entry))) => {
                    let time_ns = entry.time_ns().wrapping_sub(self.start.monotonic_ns);
                    return Ok(Poll::Ready(Some(Row {
                        kind: entry.topic().index(),
                        time_ns: Some(time_ns.cast_signed()),
                        message: Message::Entry(entry),
                    })));
                }
                Ok(Some(Heard::Missed(count))) => {
                    self.missed += count;
                    eprintln!(
                        "singletrack: {}: {count} entries of all topics missed: \
                         what is printed is not taken as fast as they come",
                        self.path.display()
                    );
                }
                Err(ClientError::Ended) => return Ok(Poll::Ready(None)),
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn wait(&mut self) -> Result<()> {
        thread::sleep(LIVE);
        Ok(())
    }
}

/// Where rows come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// The running daemon.
    Live,
    /// A record.
    Record,
    /// A serial port.
    Serial,
    /// Bytes of the line, in a file.
    Raw,
    /// Bytes of the line, on standard input.
    Stdin,
}

/// The beginning of every MCAP file.
const MCAP_MAGIC: [u8; 5] = *b"\x89MCAP";

impl Place {
    /// The source that the command line names, and its path or what else it is called.
    pub(super) fn of(args: &DumpArgs) -> (Self, &Path) {
        let path = match (&args.serial, &args.source) {
            (Some(port), _) => return (Self::Serial, port),
            (None, Some(path)) if path.as_os_str() != "-" => path,
            (None, _) => return (Self::Stdin, Path::new("standard input")),
        };
        let name = path.to_string_lossy();
        let place = match path.metadata() {
            _ if name == "live" => Self::Live,
            _ if name.ends_with(".mcap") || name.ends_with(".mcap.part") => Self::Record,
            Ok(metadata) if metadata.file_type().is_char_device() => Self::Serial,
            Ok(metadata) if metadata.is_file() && !begins_as_mcap(path) => Self::Raw,
            Ok(metadata) if metadata.is_file() || metadata.is_dir() => Self::Record,
            // A pipe gives its bytes once.
            Ok(_) => Self::Raw,
            // Opening a record reports best why it failed.
            Err(_) => Self::Record,
        };
        (place, path)
    }
}

fn begins_as_mcap(path: &Path) -> bool {
    let mut magic = [0; MCAP_MAGIC.len()];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut magic));
    read.is_ok() && magic == MCAP_MAGIC
}

/// The longest time that a source waits for more.
pub(super) const PATIENCE: Duration = Duration::from_millis(100);
/// Time between two looks at what the daemon sends.
const LIVE: Duration = Duration::from_millis(10);

/// The clocks as they are now.
pub(super) fn now() -> ClockMapping {
    ClockMapping {
        monotonic_ns: monotonic_ns(),
        wall_ns: u64::try_from(Timestamp::now().as_nanosecond()).unwrap_or(0),
    }
}

/// A row, whose message is not yet read.
pub(super) struct Row<'a> {
    /// The index of its kind.
    pub(super) kind: usize,
    /// When it reached the host, in ns since the start; none before the first time
    /// is known.
    pub(super) time_ns: Option<i64>,
    pub(super) message: Message<'a>,
}

/// The message of a row.
pub(super) enum Message<'a> {
    /// The one that the reader of a record is at. For printing, it becomes text without an [`Entry`]
    /// between.
    Recorded(&'a mut Reader),
    /// What the running daemon sent.
    Entry(Box<Entry>),
    /// What came over the line.
    Frame(Frame),
}

/// What a stretch of bytes on the line up to a zero holds.
pub(super) struct Frame {
    /// The name of its kind.
    pub(super) name: &'static str,
    pub(super) fields: Vec<(String, Value)>,
    /// The message, or in a word why there is none.
    pub(super) message: Result<ToHost, &'static str>,
}

impl Row<'_> {
    /// When it reached the host, in seconds.
    fn time(&self) -> Value {
        let time_ns = self.time_ns.map(|ns| ns as f64 / 1e9);
        time_ns.map_or(Value::Absent, Value::Float)
    }

    /// Fills `values` with its fields, in the order of its kind, unless they are there.
    pub(super) fn read_values(&mut self, values: &mut Vec<Value>) -> Result<()> {
        match &mut self.message {
            _ if !values.is_empty() => return Ok(()),
            Message::Recorded(reader) => reader.read_values(values)?,
            Message::Entry(entry) => *values = entry.values(),
            Message::Frame(frame) => {
                let fields = frame.fields.iter();
                *values = fields.map(|(_, value)| value.clone()).collect();
            }
        }
        values.push(self.time());
        Ok(())
    }

    /// Adds it to `json` as one object with all its fields: an entry as a record has it, a frame with
    /// its time.
    pub(super) fn write_json(&mut self, json: &mut String) -> Result<()> {
        let time = self.time();
        match &mut self.message {
            Message::Recorded(reader) => reader.write_json(json)?,
            Message::Entry(entry) => entry.write_json(json),
            Message::Frame(frame) => {
                let fields = frame.fields.iter();
                let fields = fields.map(|(name, value)| (name.as_str(), value));
                write_json_object(json, frame.name, [(TIME, &time)].into_iter().chain(fields));
            }
        }
        Ok(())
    }
}

/// The next row of a source, nothing at its end, or nothing yet: [`Source::wait`] waits for more.
pub(super) type Next<'a> = Result<Poll<Option<Row<'a>>>>;

/// What is known of a source beside its rows.
#[derive(Clone, Debug, Default)]
pub(super) struct About {
    /// When it starts, if that is known.
    pub(super) start: Option<ClockMapping>,
    /// The times of its first and its last row, in ns since its start, if they are known before it is
    /// read.
    pub(super) span_ns: Option<[i64; 2]>,
    /// Bytes that came over the line.
    pub(super) line_bytes: Option<u64>,
    /// Rows that it could not hand over in time.
    pub(super) missed: u64,
    /// Whether it is a record that has not been finished.
    pub(super) is_unfinished: bool,
    /// A note for standard error, of how it ended.
    pub(super) note: Option<String>,
}

/// Gives rows, one after another.
pub(super) trait Source {
    /// What is known so far beside the rows.
    fn about(&self) -> About;

    /// Goes to the next row, without waiting.
    fn next(&mut self) -> Next<'_>;

    /// Waits for more, but not for long.
    fn wait(&mut self) -> Result<()> {
        thread::sleep(PATIENCE);
        Ok(())
    }
}
