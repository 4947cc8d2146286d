//! Frames on the line itself, whole and broken ones: from a serial port, or from a capture of its
//! bytes.

use std::{
    borrow::Cow,
    fs::File,
    io::{self, Read},
    os::fd::AsFd as _,
    path::Path,
    thread,
    time::Instant,
};

use singletrack_protocol::{
    DecodeError, Decoder, FrameError, MAX_PAYLOAD_LENGTH, Packet, ToHost, VERSION,
};
use singletrack_record::{Entry, StatusRecord, TelemetryRecord, Value};
use singletrackd::serial_port::{self, ReadHalf};

use super::{
    DumpError,
    source::{Close, Kind, Message, Next, PATIENCE, Row, Source, TELEMETRY, Times, wall_ns},
};
use crate::operator::terminal::wait_to_read;

/// How much is read at once.
const READ_LENGTH: usize = 64 << 10;
/// No more bytes than this of something broken are shown.
const SHOWN_BYTES: usize = 64;
/// A board whose clock went back by more than this has restarted.
const RESTART_US: i32 = -1_000_000;

/// What a stretch of bytes up to a zero holds.
struct Frame {
    /// The name of its kind.
    name: &'static str,
    fields: Vec<(String, Value)>,
    /// The message as a record has it, if it has any.
    entry: Option<Entry>,
    /// Why it is no frame, in a word.
    broken: Option<&'static str>,
    /// Where it begins, in bytes from the start.
    offset: u64,
    /// How many bytes it has, with the zero that ends it.
    length: u64,
}

impl Frame {
    fn new(name: &'static str, fields: Vec<(&str, Value)>) -> Self {
        let fields = fields.into_iter();
        Self {
            name,
            fields: fields
                .map(|(name, value)| (name.to_owned(), value))
                .collect(),
            entry: None,
            broken: None,
            offset: 0,
            length: 0,
        }
    }

    /// The row of a message of the board.
    fn of(message: &ToHost) -> Self {
        match message {
            ToHost::Hello(hello) => {
                let version = hello.software_version.map(|part| part.to_string());
                let fields = vec![
                    ("protocol_version", number(hello.protocol_version)),
                    ("software_version", text(version.join("."))),
                    ("nonce", number(hello.nonce)),
                ];
                Self::new("hello", fields)
            }
            ToHost::Telemetry(telemetry) => Self::of_entry(Entry::Telemetry(TelemetryRecord {
                receive_time_ns: 0,
                board_time_host_ns: 0,
                imu_time_host_ns: None,
                telemetry: *telemetry,
            })),
            ToHost::Status(status) => Self::of_entry(Entry::Status(StatusRecord {
                receive_time_ns: 0,
                status: *status,
            })),
            ToHost::Acknowledgement(answer) => {
                let fields = vec![
                    ("request", text(answer.request.name())),
                    ("sequence", number(answer.sequence.0)),
                    ("configuration_hash", number(answer.configuration_hash)),
                ];
                Self::new("acknowledgement", fields)
            }
            ToHost::Refusal(answer) => {
                let fields = vec![
                    ("request", text(answer.request.name())),
                    ("sequence", number(answer.sequence.0)),
                    ("reason", text(answer.reason.name())),
                ];
                Self::new("refusal", fields)
            }
            ToHost::Identity(identity) => {
                Self::new("identity", vec![("car_id", number(identity.car_id))])
            }
        }
    }

    /// With the fields that come over the line: all from the board's clock on. The host adds those
    /// before.
    fn of_entry(entry: Entry) -> Self {
        let name = entry.topic().name();
        let fields = entry.topic().fields().into_iter().zip(entry.values());
        let fields = fields.skip_while(|(name, _)| name != "board_time_us");
        Self {
            fields: fields.collect(),
            entry: Some(entry),
            ..Self::new(name, Vec::new())
        }
    }

    /// Bytes that are no frame: why, in a word and in a sentence, and the first of them.
    fn broken(reason: &'static str, detail: &impl ToString, bytes: &[u8]) -> Self {
        let mut shown: Vec<_> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        if shown.len() == SHOWN_BYTES {
            shown.push("...".to_owned());
        }
        let fields = vec![
            ("reason", text(reason)),
            ("detail", text(detail.to_string())),
            ("bytes", text(shown.join(" "))),
        ];
        Self {
            broken: Some(reason),
            ..Self::new("broken", fields)
        }
    }

    /// The board's clock when it was made, if the message holds it: in µs, wrapping.
    const fn board_time_us(&self) -> Option<u32> {
        match &self.entry {
            Some(Entry::Telemetry(record)) => Some(record.telemetry.board_time_us),
            Some(Entry::Status(record)) => Some(record.status.board_time_us),
            _ => None,
        }
    }
}

fn number(number: impl Into<u64>) -> Value {
    Value::Unsigned(number.into())
}

fn text(text: impl Into<Cow<'static, str>>) -> Value {
    Value::Text(text.into())
}

/// The kinds of frames, by their type bytes, then what is broken. Every one has an offset and a
/// length.
pub(super) fn kinds() -> Vec<Kind> {
    // Zeros are a payload of every message.
    let zeros = [0; MAX_PAYLOAD_LENGTH];
    let example = |kind: u8| match ToHost::decode(Packet { kind, payload: &[] }) {
        Err(DecodeError::Length { expected, .. }) => {
            let payload = zeros.get(..expected)?;
            ToHost::decode(Packet { kind, payload }).ok()
        }
        other => other.ok(),
    };
    let messages = (0..=u8::MAX).filter_map(example);
    let frames = messages.map(|message| Frame::of(&message));
    let kind = |frame: Frame| {
        let own = frame.fields.into_iter().map(|(name, _)| name);
        let place = ["offset", "length"].map(str::to_owned);
        let brief = match &frame.entry {
            Some(Entry::Telemetry(_)) => &format!("offset length board_time_us {TELEMETRY}"),
            _ => "",
        };
        Kind::new(frame.name, place.into_iter().chain(own).collect(), brief)
    };
    frames
        .chain([Frame::broken("", &"", &[])])
        .map(kind)
        .collect()
}

/// The frames of a line.
pub(super) struct Line<'a> {
    name: String,
    input: Input,
    clock: Clock,
    kinds: &'a [Kind],
    follow: bool,
    received: Vec<u8>,
    /// The next byte in `received`.
    at: usize,
    /// There is no more to read: a capture is read, or a port hung up.
    ended: bool,
    decoder: Decoder,
    /// Bytes taken.
    taken: u64,
    /// Where the stretch that is being taken begins.
    begin: u64,
    /// The first bytes of this stretch.
    bytes: Vec<u8>,
    /// The version in the last greeting, if it is not ours.
    other_version: Option<u16>,
    /// How many frames were whole.
    whole: u64,
    found: Option<Frame>,
}

/// Where the bytes come from.
pub(super) enum Input {
    Serial(ReadHalf),
    File(File),
}

/// The clock that dates the frames.
enum Clock {
    /// The host's, when they arrive.
    Arrival {
        start: Instant,
        start_wall_ns: Option<u64>,
    },
    /// The board's, since its first time: its last time, and the time passed since the first.
    Board { last_us: Option<u32>, since_us: i64 },
}

impl Clock {
    /// When a frame came, in ns since the start.
    fn date(&mut self, frame: &Frame) -> Option<i64> {
        match self {
            Self::Arrival { start, .. } => i64::try_from(start.elapsed().as_nanos()).ok(),
            Self::Board { last_us, since_us } => {
                if let Some(board_us) = frame.board_time_us() {
                    let before_us = last_us.replace(board_us).unwrap_or(board_us);
                    let passed = board_us.wrapping_sub(before_us).cast_signed();
                    // A restarted clock goes on from where the last one stopped.
                    if passed > RESTART_US {
                        *since_us += i64::from(passed);
                    }
                }
                last_us.map(|_| since_us.saturating_mul(1_000))
            }
        }
    }
}

impl Input {
    /// Opens a serial port, and never writes to it.
    pub(super) fn serial(path: &Path, baud: u32) -> Result<Self, DumpError> {
        // The half that writes is closed unused.
        let (read, _) = serial_port::open(path, baud)?;
        Ok(Self::Serial(read))
    }

    /// A capture with this name: a file, or standard input.
    pub(super) fn capture(name: &str, file: io::Result<File>) -> Result<Self, String> {
        file.map(Self::File)
            .map_err(|error| unreadable(name, &error))
    }
}

impl<'a> Line<'a> {
    /// The frames of `kinds`, which are those of the line.
    pub(super) fn new(name: String, input: Input, kinds: &'a [Kind], follow: bool) -> Self {
        let clock = match input {
            Input::Serial(_) => Clock::Arrival {
                start: Instant::now(),
                start_wall_ns: wall_ns(),
            },
            Input::File(_) => Clock::Board {
                last_us: None,
                since_us: 0,
            },
        };
        Self {
            name,
            input,
            clock,
            kinds,
            follow,
            received: Vec::new(),
            at: 0,
            ended: false,
            decoder: Decoder::new(),
            taken: 0,
            begin: 0,
            bytes: Vec::new(),
            other_version: None,
            whole: 0,
            found: None,
        }
    }

    /// The next stretch in what has been received.
    fn search(&mut self) -> Option<Frame> {
        while let Some(byte) = self.received.get(self.at).copied() {
            self.at += 1;
            self.taken += 1;
            if byte == 0 {
                let frame = self.frame();
                if let Some(found) = self.end_stretch(frame) {
                    return Some(found);
                }
            } else {
                self.decoder.push_data(byte);
                if self.bytes.len() < SHOWN_BYTES {
                    self.bytes.push(byte);
                }
            }
        }
        let unfinished = self.ended && self.taken > self.begin;
        let frame = unfinished.then(|| {
            let detail = "the bytes end in the middle of a frame";
            Frame::broken("unfinished", &detail, &self.bytes)
        });
        self.ended.then(|| self.end_stretch(frame))?
    }

    /// What the stretch holds that a zero ends; none if it is empty.
    fn frame(&mut self) -> Option<Frame> {
        let packet = match self.decoder.push(0)? {
            Ok(packet) => packet,
            Err(error) => {
                let reason = match error {
                    FrameError::Truncated => "truncated",
                    FrameError::TooLong => "too-long",
                    FrameError::TooShort(_) => "too-short",
                    FrameError::CheckSum => "check-sum",
                };
                return Some(Frame::broken(reason, &error, &self.bytes));
            }
        };
        let message = ToHost::decode(packet);
        if let Ok(ToHost::Hello(hello)) = &message {
            let version = hello.protocol_version;
            self.other_version = (version != VERSION).then_some(version);
        } else if let Some(version) = self.other_version {
            // Nothing but another greeting is believed, even if it looks well.
            let detail = format!(
                "the sender speaks version {version} of the protocol, this program version {VERSION}: use the singletrack of its release"
            );
            return Some(Frame::broken("version", &detail, &self.bytes));
        }
        Some(match message {
            Ok(message) => Frame::of(&message),
            Err(error) => {
                let reason = match error {
                    DecodeError::UnknownType(_) => "unknown-type",
                    DecodeError::Length { .. } => "payload-length",
                    DecodeError::Value { .. } => "payload-value",
                };
                Frame::broken(reason, &error, &self.bytes)
            }
        })
    }

    fn end_stretch(&mut self, frame: Option<Frame>) -> Option<Frame> {
        let offset = self.begin;
        self.begin = self.taken;
        self.bytes.clear();
        let frame = frame?;
        self.whole += u64::from(frame.broken.is_none());
        Some(Frame {
            offset,
            length: self.taken - offset,
            ..frame
        })
    }
}

/// The bytes of the line can't be read.
fn unreadable(name: &str, error: &io::Error) -> String {
    format!("can't read {name}: {error}")
}

impl Source for Line<'_> {
    fn times(&self) -> Times {
        Times {
            start_wall_ns: match self.clock {
                Clock::Arrival { start_wall_ns, .. } => start_wall_ns,
                Clock::Board { .. } => None,
            },
            span_ns: None,
        }
    }

    fn next(&mut self) -> Result<Next, DumpError> {
        let Some(found) = self.search() else {
            if !self.ended {
                return Ok(Next::Pending);
            }
            if matches!(self.input, Input::File(_)) && self.whole == 0 {
                let Self { name, taken, .. } = self;
                let why = format!(
                    "{name} holds no whole frame of the protocol in {taken} bytes: name a \
                     capture of the serial line from the board, or a record (*.mcap or \
                     *.mcap.part)"
                );
                return Err(why.into());
            }
            return Ok(Next::End);
        };
        let kind = self.kinds.iter().position(|kind| kind.name == found.name);
        let time_ns = self.clock.date(&found);
        self.found = Some(found);
        Ok(Next::Row(Row {
            kind: kind.unwrap_or_default(),
            time_ns,
        }))
    }

    fn wait(&mut self) -> Result<(), DumpError> {
        let input = match &self.input {
            Input::Serial(port) => port.as_fd(),
            Input::File(file) => file.as_fd(),
        };
        let ready = wait_to_read([input], PATIENCE);
        if !ready.map_err(|error| unreadable(&self.name, &error))? {
            return Ok(());
        }
        self.received.resize(READ_LENGTH, 0);
        self.at = 0;
        let read = match &mut self.input {
            Input::Serial(port) => match port.read(&mut self.received) {
                // Unplugged, or the other end of a pseudo-terminal is closed.
                Some(Ok(0) | Err(_)) => {
                    self.ended = true;
                    Ok(0)
                }
                read => read.unwrap_or(Ok(0)),
            },
            Input::File(file) => file.read(&mut self.received).inspect(|length| {
                if *length == 0 && self.follow {
                    thread::sleep(PATIENCE);
                } else if *length == 0 {
                    self.ended = true;
                }
            }),
        };
        let length = read.as_ref().copied().unwrap_or_default();
        self.received.truncate(length);
        match read {
            Err(error) if error.kind() != io::ErrorKind::Interrupted => {
                Err(unreadable(&self.name, &error).into())
            }
            _ => Ok(()),
        }
    }

    fn take_message(&mut self, take: &mut dyn FnMut(Message<'_>)) -> Result<(), DumpError> {
        if let Some(found) = &self.found {
            take(match (&found.entry, found.broken) {
                (Some(entry), _) => Message::Entry(entry),
                (None, Some(reason)) => Message::Broken(reason),
                (None, None) => Message::Other,
            });
        }
        Ok(())
    }

    fn read_values(&mut self, values: &mut Vec<Value>) -> Result<(), DumpError> {
        values.clear();
        if let Some(found) = &self.found {
            values.extend([found.offset, found.length].map(Value::Unsigned));
            values.extend(found.fields.iter().map(|(_, value)| value.clone()));
        }
        Ok(())
    }

    fn close(&self) -> Close {
        let hung_up = self.ended && matches!(self.input, Input::Serial(_));
        Close {
            note: hung_up.then(|| format!("{}: the line hung up", self.name)),
            line_bytes: Some(self.taken),
            ..Close::default()
        }
    }
}
