//! Frames on the line itself, whole and broken ones: from a serial port, or from a capture of its
//! bytes.

use std::{borrow::Cow, fs::File, io, os::fd::AsFd, path::Path, task::Poll, thread, vec};

use rustix::io::Errno;
use singletrack_protocol::{
    DecodeError, Decoder, FrameError, MAX_PAYLOAD_LENGTH, Packet, ToHost, VERSION,
};
use singletrack_record::{ClockMapping, Entry, StatusRecord, TelemetryRecord, Value};
use singletrackd::{monotonic_ns, serial_port};

use super::{
    DumpArgs,
    source::{About, Frame, Kind, Message, Next, PATIENCE, Place, Row, Source, TELEMETRY, now},
};
use crate::{Result, operator::terminal::wait_to_read};

/// How much is read at once.
const READ_LENGTH: usize = 64 << 10;
/// No more bytes than this of something broken are shown.
const SHOWN_BYTES: usize = 64;
/// A board whose clock went back by more than this has restarted.
const RESTART_US: i32 = -1_000_000;

/// Where a frame begins, in bytes from the start, and how many bytes it has, with the zero that ends
/// it.
type Extent = [u64; 2];

impl Frame {
    fn new(
        name: &'static str,
        [offset, length]: Extent,
        message: Result<ToHost, &'static str>,
    ) -> Self {
        let frame = Self {
            name,
            fields: Vec::new(),
            message,
        };
        frame.number("offset", offset).number("length", length)
    }

    fn with(mut self, name: &str, value: Value) -> Self {
        self.fields.push((name.to_owned(), value));
        self
    }

    fn number(self, name: &str, number: impl Into<u64>) -> Self {
        self.with(name, Value::Unsigned(number.into()))
    }

    fn text(self, name: &str, text: impl Into<Cow<'static, str>>) -> Self {
        self.with(name, Value::Text(text.into()))
    }

    /// The row of a message of the board.
    fn of(message: ToHost, extent: Extent) -> Self {
        let named = |name| Self::new(name, extent, Ok(message));
        match message {
            ToHost::Hello(hello) => {
                let version = hello.software_version.map(|part| part.to_string());
                named("hello")
                    .number("protocol_version", hello.protocol_version)
                    .text("software_version", version.join("."))
                    .number("nonce", hello.nonce)
            }
            ToHost::Telemetry(telemetry) => {
                named("telemetry").with_received(&Entry::Telemetry(TelemetryRecord {
                    receive_time_ns: 0,
                    board_time_host_ns: 0,
                    imu_time_host_ns: None,
                    telemetry,
                }))
            }
            ToHost::Status(status) => named("status").with_received(&Entry::Status(StatusRecord {
                receive_time_ns: 0,
                status,
            })),
            ToHost::Acknowledgement(answer) => named("acknowledgement")
                .text("request", answer.request.name())
                .number("sequence", answer.sequence.0)
                .number("configuration_hash", answer.configuration_hash),
            ToHost::Refusal(answer) => named("refusal")
                .text("request", answer.request.name())
                .number("sequence", answer.sequence.0)
                .text("reason", answer.reason.name()),
            ToHost::Identity(identity) => named("identity").number("car_id", identity.car_id),
        }
    }

    /// With the fields of an entry that come over the line: all from the board's clock on. The host
    /// adds those before.
    fn with_received(mut self, entry: &Entry) -> Self {
        let fields = entry.topic().fields().into_iter().zip(entry.values());
        self.fields
            .extend(fields.skip_while(|(name, _)| name != "board_time_us"));
        self
    }

    /// Bytes that are no frame: why, in a word and in a sentence, and the first of them.
    fn broken(reason: &'static str, detail: &str, bytes: &[u8], extent: Extent) -> Self {
        let mut shown: Vec<_> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        if shown.len() == SHOWN_BYTES {
            shown.push("...".to_owned());
        }
        Self::new("broken", extent, Err(reason))
            .text("reason", reason)
            .text("detail", detail.to_owned())
            .text("bytes", shown.join(" "))
    }
}

/// The kinds of frames, by their type bytes, then what is broken. Every one has an offset and a
/// length.
pub(super) fn kinds() -> Vec<Kind> {
    // Zeros are a payload of every message.
    let zeros = [0; MAX_PAYLOAD_LENGTH];
    let payloads = || (0..=MAX_PAYLOAD_LENGTH).filter_map(|length| zeros.get(..length));
    let example = |kind: u8| {
        let mut packets = payloads().map(|payload| Packet { kind, payload });
        packets.find_map(|packet| ToHost::decode(packet).ok())
    };
    let messages = (0..=u8::MAX).filter_map(example);
    let frames = messages.map(|message| Frame::of(message, [0; 2]));
    let kind = |frame: Frame| {
        let brief = match frame.message {
            Ok(ToHost::Telemetry(_)) => &format!("offset length board_time_us {TELEMETRY}"),
            _ => "",
        };
        let fields = frame.fields.into_iter().map(|(name, _)| name);
        Kind::new(frame.name, fields.collect(), brief)
    };
    let broken = Frame::broken("", "", &[], [0; 2]);
    frames.chain([broken]).map(kind).collect()
}

/// The frames of a line.
pub(super) struct Line<'a> {
    name: String,
    input: Box<dyn AsFd>,
    /// When listening to a serial port began, whose frames are dated when they arrive; none of a
    /// capture.
    start: Option<ClockMapping>,
    /// The board's clock, which dates the frames of a capture: its last time, and the time passed since
    /// its first.
    board: Option<(u32, i64)>,
    kinds: &'a [Kind],
    follow: bool,
    received: vec::IntoIter<u8>,
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
    /// Whether a frame was whole.
    any_whole: bool,
}

impl<'a> Line<'a> {
    /// The frames of `kinds`, which are those of the line: from a serial port, which is never written
    /// to, from a capture, or from standard input.
    pub(super) fn open(
        (place, path): (Place, &Path),
        args: &DumpArgs,
        kinds: &'a [Kind],
    ) -> Result<Self> {
        let name = path.display().to_string();
        let failed = |error: io::Error| unreadable(&name, &error);
        let input: Box<dyn AsFd> = match place {
            // The half that writes is closed unused.
            Place::Serial => Box::new(serial_port::open(path, args.baud)?.0),
            Place::Raw => Box::new(File::open(path).map_err(failed)?),
            _ => Box::new(io::stdin()),
        };
        Ok(Self {
            name,
            input,
            start: (place == Place::Serial).then(now),
            board: None,
            kinds,
            follow: args.follow && place == Place::Raw,
            received: Vec::new().into_iter(),
            ended: false,
            decoder: Decoder::new(),
            taken: 0,
            begin: 0,
            bytes: Vec::new(),
            other_version: None,
            any_whole: false,
        })
    }

    /// When a frame came, in ns since the start.
    fn date(&mut self, frame: &Frame) -> Option<i64> {
        if let Some(start) = self.start {
            return i64::try_from(monotonic_ns() - start.monotonic_ns).ok();
        }
        // Wrapping.
        let board_us = match frame.message {
            Ok(ToHost::Telemetry(telemetry)) => Some(telemetry.board_time_us),
            Ok(ToHost::Status(status)) => Some(status.board_time_us),
            _ => None,
        };
        if let Some(board_us) = board_us {
            let (before_us, since_us) = self.board.unwrap_or((board_us, 0));
            let passed = board_us.wrapping_sub(before_us).cast_signed();
            // A restarted clock goes on from where the last one stopped.
            let passed = if passed > RESTART_US { passed } else { 0 };
            self.board = Some((board_us, since_us + i64::from(passed)));
        }
        let (_, since_us) = self.board?;
        Some(since_us.saturating_mul(1_000))
    }

    /// The next stretch in what has been received.
    fn search(&mut self) -> Option<Frame> {
        while let Some(byte) = self.received.next() {
            self.taken += 1;
            if self.decoder.push_data(byte) {
                if self.bytes.len() < SHOWN_BYTES {
                    self.bytes.push(byte);
                }
                continue;
            }
            let frame = self.frame();
            self.begin = self.taken;
            self.bytes.clear();
            if frame.is_some() {
                return frame;
            }
        }
        if !self.ended || self.taken == self.begin {
            return None;
        }
        let detail = "the bytes end in the middle of a frame";
        let frame = Frame::broken("unfinished", detail, &self.bytes, self.extent());
        self.begin = self.taken;
        Some(frame)
    }

    /// That of the stretch so far.
    const fn extent(&self) -> Extent {
        [self.begin, self.taken - self.begin]
    }

    /// What the stretch holds that a zero ends; none if it is empty.
    fn frame(&mut self) -> Option<Frame> {
        let message = self.decoder.push(0)?.map(ToHost::decode);
        if let Ok(Ok(ToHost::Hello(hello))) = &message {
            let version = hello.protocol_version;
            self.other_version = (version != VERSION).then_some(version);
        }
        let reason = match (&message, self.other_version) {
            (Ok(Ok(message @ ToHost::Hello(_))), _) | (Ok(Ok(message)), None) => {
                return Some(Frame::of(*message, self.extent()));
            }
            (Err(FrameError::Truncated), _) => "truncated",
            (Err(FrameError::TooLong), _) => "too-long",
            (Err(FrameError::TooShort(_)), _) => "too-short",
            (Err(FrameError::CheckSum), _) => "check-sum",
            // Nothing but another greeting is believed, even if it looks well.
            (Ok(_), Some(_)) => "version",
            (Ok(Err(DecodeError::UnknownType(_))), None) => "unknown-type",
            (Ok(Err(DecodeError::Length { .. })), None) => "payload-length",
            (Ok(Err(DecodeError::Value { .. })), None) => "payload-value",
        };
        let detail = match (message, self.other_version) {
            (Err(error), _) => error.to_string(),
            (Ok(Err(error)), None) => error.to_string(),
            (Ok(_), version) => format!(
                "the sender speaks version {} of the protocol, this program version {VERSION}: use the singletrack of its release",
                version.unwrap_or_default()
            ),
        };
        Some(Frame::broken(reason, &detail, &self.bytes, self.extent()))
    }
}

/// The bytes of the line can't be read.
fn unreadable(name: &str, error: &io::Error) -> String {
    format!("can't read {name}: {error}")
}

impl Source for Line<'_> {
    fn about(&self) -> About {
        let hung_up = self.ended && self.start.is_some();
        About {
            start: self.start,
            line_bytes: Some(self.taken),
            note: hung_up.then(|| "the line hung up".to_owned()),
            ..About::default()
        }
    }

    fn next(&mut self) -> Next<'_> {
        let Some(found) = self.search() else {
            if !self.ended {
                return Ok(Poll::Pending);
            }
            if self.start.is_none() && !self.any_whole {
                let Self { name, taken, .. } = self;
                let why = format!(
                    "{name} holds no whole frame of the protocol in {taken} bytes: name a \
                     capture of the serial line from the board, or a record (*.mcap or \
                     *.mcap.part)"
                );
                return Err(why.into());
            }
            return Ok(Poll::Ready(None));
        };
        self.any_whole |= found.message.is_ok();
        let kind = self.kinds.iter().position(|kind| kind.name == found.name);
        Ok(Poll::Ready(Some(Row {
            kind: kind.unwrap_or_default(),
            time_ns: self.date(&found),
            message: Message::Frame(found),
        })))
    }

    fn wait(&mut self) -> Result<()> {
        let failed = |error: io::Error| unreadable(&self.name, &error);
        if !wait_to_read([self.input.as_fd()], PATIENCE).map_err(failed)? {
            return Ok(());
        }
        let is_port = self.start.is_some();
        let mut received = vec![0; READ_LENGTH];
        let read = match rustix::io::read(&self.input, &mut received) {
            Err(Errno::INTR) => None,
            Err(Errno::AGAIN) if is_port => None,
            // Unplugged, or the other end of a pseudo-terminal is closed.
            Err(_) if is_port => Some(0),
            Ok(0) if self.follow => {
                thread::sleep(PATIENCE);
                None
            }
            read => Some(read.map_err(|error| failed(error.into()))?),
        };
        self.ended = read == Some(0);
        received.truncate(read.unwrap_or(0));
        self.received = received.into_iter();
        Ok(())
    }
}
