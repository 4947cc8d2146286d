//! Frames on the line itself, whole and broken ones: from a serial port, or from a capture of its
//! bytes.

use std::{
    fs::File,
    io::{self, Read},
    os::fd::AsFd as _,
    path::Path,
    thread,
    time::Instant,
};

use clap::ValueEnum;
use singletrack_protocol::{
    Acknowledgement, Arm, Configuration, Configure, DecodeError, Decoder, Disarm, Drive,
    EmergencyStop, EscKind, FailsafeAction, FrameError, Hello, Identity, ImuAxis, Jog,
    MAX_PAYLOAD_LENGTH, Packet, Refusal, RefusalReason, Request, Sequence, Status, Telemetry,
    ToBoard, ToHost, VERSION,
};
use singletrack_record::{Entry, StatusRecord, TelemetryRecord, Topic, Value};
use singletrackd::serial_port::{self, ReadHalf};

use super::{
    DumpError,
    source::{
        Broken, Close, Content, Kind, Message, Next, PATIENCE, Row, Source, TELEMETRY, wall_ns,
    },
};
use crate::operator::terminal::wait_to_read;

/// The direction of the bytes on the line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Direction {
    /// From the board to the host: what a serial port receives.
    #[default]
    ToHost,
    /// From the host to the board.
    ToBoard,
}

/// How much is read at once.
const READ_LENGTH: usize = 64 << 10;
/// No more bytes than this of something broken are shown.
const SHOWN_BYTES: usize = 64;
/// A board whose clock went back by more than this has restarted.
const RESTART_US: i32 = -1_000_000;

/// The form of a field in which it is printed.
trait Show {
    fn show(&self) -> Value;
}

macro_rules! show {
    ($($($type:ty),* => |$value:ident| $shown:expr;)*) => {$($(
        impl Show for $type {
            fn show(&self) -> Value {
                let $value = self;
                $shown
            }
        }
    )*)*};
}

show! {
    bool => |value| Value::Bool(*value);
    u16, u32 => |value| Value::Unsigned((*value).into());
    i16 => |value| Value::Signed((*value).into());
    Sequence => |value| Value::Unsigned(value.0.into());
    EscKind, FailsafeAction, ImuAxis, RefusalReason, Request =>
        |value| Value::Text(value.name().into());
    // A version.
    [u8; 3] => |value| Value::Text(value.map(|part| part.to_string()).join(".").into());
}

/// The fields of a message, by their names.
trait Fields {
    /// Gives each to `field`.
    fn fields(&self, field: &mut dyn FnMut(&str, Value));
}

macro_rules! fields {
    ($($message:ident: $($first:ident $(. $next:ident)*),*;)*) => {$(
        impl Fields for $message {
            fn fields(&self, field: &mut dyn FnMut(&str, Value)) {
                $(field(
                    concat!(stringify!($first) $(, ".", stringify!($next))*),
                    self.$first $(. $next)* .show(),
                );)*
            }
        }
    )*};
}

fields! {
    Hello: protocol_version, software_version, nonce;
    Acknowledgement: request, sequence, configuration_hash;
    Refusal: request, sequence, reason;
    Identity: car_id;
    Configuration: esc.kind, servo.centre_us, servo.gain_us_per_rad, servo.min_us, servo.max_us,
        servo.slew_us_per_20ms, esc.neutral_us, esc.deadband_us, esc.min_us, esc.max_us,
        esc.slew_us_per_20ms, esc.brake_us, speed.pulse_distance_um, speed.feed_forward_us_per_m_s,
        speed.proportional_us_per_m_s, speed.integral_us_per_m, speed.integral_limit_us,
        speed.max_forward_mm_s, speed.max_reverse_mm_s, failsafe, max_pose_age_ms, stop_input,
        kill_output, max_roll_out_ms, car_id, imu_axes.forward, imu_axes.left, imu_axes.up;
    Arm: request, configuration_hash, telemetry_time_us;
    Disarm: request;
    EmergencyStop: request;
    Drive: sequence, speed_mm_s, steering_100urad, telemetry_time_us, pose_age_ms, brake;
    Jog: sequence, telemetry_time_us, servo_us, esc_us;
}

impl Fields for Configure {
    fn fields(&self, field: &mut dyn FnMut(&str, Value)) {
        field("request", self.request.show());
        field("configuration_hash", self.configuration.hash().show());
        self.configuration.fields(field);
    }
}

impl Fields for Entry {
    /// The fields that come over the line: all from the board's clock on. The host adds those
    /// before.
    fn fields(&self, field: &mut dyn FnMut(&str, Value)) {
        let names = self.topic().fields();
        let fields = names.iter().zip(self.values());
        for (name, value) in fields.skip_while(|(name, _)| *name != "board_time_us") {
            field(name, value);
        }
    }
}

impl Fields for Telemetry {
    fn fields(&self, field: &mut dyn FnMut(&str, Value)) {
        let record = TelemetryRecord {
            receive_time_ns: 0,
            board_time_host_ns: 0,
            imu_time_host_ns: None,
            telemetry: *self,
        };
        Entry::Telemetry(record).fields(field);
    }
}

impl Fields for Status {
    fn fields(&self, field: &mut dyn FnMut(&str, Value)) {
        let record = StatusRecord {
            receive_time_ns: 0,
            status: *self,
        };
        Entry::Status(record).fields(field);
    }
}

impl Fields for Broken {
    fn fields(&self, field: &mut dyn FnMut(&str, Value)) {
        let mut bytes: Vec<_> = self
            .bytes
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        if bytes.len() == SHOWN_BYTES {
            bytes.push("...".to_owned());
        }
        field("reason", Value::Text(self.reason.into()));
        field("detail", Value::Text(self.detail.clone().into()));
        field("bytes", Value::Text(bytes.join(" ").into()));
    }
}

impl Content {
    /// The name of its kind, and its fields.
    const fn message(&self) -> (&'static str, &dyn Fields) {
        match self {
            Self::ToHost(ToHost::Hello(hello)) | Self::ToBoard(ToBoard::Hello(hello)) => {
                ("hello", hello)
            }
            Self::ToHost(ToHost::Telemetry(telemetry)) => (Topic::Telemetry.name(), telemetry),
            Self::ToHost(ToHost::Status(status)) => (Topic::Status.name(), status),
            Self::ToHost(ToHost::Acknowledgement(answer)) => ("acknowledgement", answer),
            Self::ToHost(ToHost::Refusal(answer)) => ("refusal", answer),
            Self::ToHost(ToHost::Identity(identity)) => ("identity", identity),
            Self::ToBoard(ToBoard::Configure(configure)) => ("configure", configure),
            Self::ToBoard(ToBoard::Arm(arm)) => ("arm", arm),
            Self::ToBoard(ToBoard::Disarm(disarm)) => ("disarm", disarm),
            Self::ToBoard(ToBoard::Drive(drive)) => ("drive", drive),
            Self::ToBoard(ToBoard::EmergencyStop(stop)) => ("emergency-stop", stop),
            Self::ToBoard(ToBoard::Jog(jog)) => ("jog", jog),
            Self::Broken(broken) => ("broken", broken),
        }
    }

    /// The board's clock when it was made, if the message holds it: in µs, wrapping.
    const fn board_time_us(&self) -> Option<u32> {
        match self {
            Self::ToHost(ToHost::Telemetry(telemetry)) => Some(telemetry.board_time_us),
            Self::ToHost(ToHost::Status(status)) => Some(status.board_time_us),
            Self::ToBoard(ToBoard::Drive(drive)) => Some(drive.telemetry_time_us),
            Self::ToBoard(ToBoard::Jog(jog)) => Some(jog.telemetry_time_us),
            Self::ToBoard(ToBoard::Arm(arm)) => Some(arm.telemetry_time_us),
            _ => None,
        }
    }
}

fn decode(direction: Direction, packet: Packet<'_>) -> Result<Content, DecodeError> {
    match direction {
        Direction::ToHost => ToHost::decode(packet).map(Content::ToHost),
        Direction::ToBoard => ToBoard::decode(packet).map(Content::ToBoard),
    }
}

/// The kinds of frames in a direction, by their type bytes, then what is broken. Every one has an
/// offset and a length.
pub(super) fn kinds(direction: Direction) -> Vec<Kind> {
    // Zeros are a payload of every message.
    let zeros = [0; MAX_PAYLOAD_LENGTH];
    let example = |kind: u8| match decode(direction, Packet { kind, payload: &[] }) {
        Err(DecodeError::Length { expected, .. }) => {
            let payload = zeros.get(..expected)?;
            decode(direction, Packet { kind, payload }).ok()
        }
        other => other.ok(),
    };
    let broken = broken("", String::new(), &[]);
    let examples = (0..=u8::MAX).filter_map(example).chain([broken]);
    let kind = |content: Content| {
        let (name, message) = content.message();
        let mut fields = vec!["offset".to_owned(), "length".to_owned()];
        message.fields(&mut |name, _| fields.push(name.to_owned()));
        let brief = match content {
            Content::ToHost(ToHost::Telemetry(_)) => {
                &format!("offset length board_time_us {TELEMETRY}")
            }
            _ => "",
        };
        Kind::new(name, fields, brief)
    };
    examples.map(kind).collect()
}

fn broken(reason: &'static str, detail: String, bytes: &[u8]) -> Content {
    Content::Broken(Broken {
        reason,
        detail,
        bytes: bytes.to_owned(),
    })
}

/// A stretch of bytes up to a zero.
struct Found {
    /// Where it begins, in bytes from the start.
    offset: u64,
    /// How many bytes it has, with the zero that ends it.
    length: u64,
    content: Content,
}

/// The frames of a line.
pub(super) struct Line<'a> {
    name: String,
    input: Input,
    clock: Clock,
    kinds: &'a [Kind],
    direction: Direction,
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
    found: Option<Found>,
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
    fn date(&mut self, content: &Content) -> Option<i64> {
        match self {
            Self::Arrival { start, .. } => i64::try_from(start.elapsed().as_nanos()).ok(),
            Self::Board { last_us, since_us } => {
                if let Some(board_us) = content.board_time_us() {
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
    pub(super) fn capture(name: &str, file: io::Result<File>) -> Result<Self, DumpError> {
        file.map(Self::File)
            .map_err(|error| unreadable(name, &error))
    }
}

impl<'a> Line<'a> {
    /// The frames of `kinds`, which are those of the direction.
    pub(super) fn new(
        name: String,
        input: Input,
        direction: Direction,
        kinds: &'a [Kind],
        follow: bool,
    ) -> Self {
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
            direction,
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
    fn search(&mut self) -> Option<Found> {
        while let Some(byte) = self.received.get(self.at).copied() {
            self.at += 1;
            self.taken += 1;
            if byte == 0 {
                let content = self.content();
                if let Some(found) = self.end_stretch(content) {
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
        let content = unfinished.then(|| {
            let detail = "the bytes end in the middle of a frame".to_owned();
            broken("unfinished", detail, &self.bytes)
        });
        self.ended.then(|| self.end_stretch(content))?
    }

    /// The content of the stretch that a zero ends; none if it is empty.
    fn content(&mut self) -> Option<Content> {
        let packet = match self.decoder.push(0)? {
            Ok(packet) => packet,
            Err(error) => {
                let reason = match error {
                    FrameError::Truncated => "truncated",
                    FrameError::TooLong => "too-long",
                    FrameError::TooShort(_) => "too-short",
                    FrameError::CheckSum => "check-sum",
                };
                return Some(broken(reason, error.to_string(), &self.bytes));
            }
        };
        let content = match decode(self.direction, packet) {
            Ok(content) => content,
            Err(error) => {
                let reason = match error {
                    DecodeError::UnknownType(_) => "unknown-type",
                    DecodeError::Length { .. } => "payload-length",
                    DecodeError::Value { .. } => "payload-value",
                };
                broken(reason, error.to_string(), &self.bytes)
            }
        };
        if let Content::ToHost(ToHost::Hello(hello)) | Content::ToBoard(ToBoard::Hello(hello)) =
            &content
        {
            let version = hello.protocol_version;
            self.other_version = (version != VERSION).then_some(version);
        } else if let Some(version) = self.other_version {
            // Nothing but another greeting is believed, even if it looks well.
            let detail = format!(
                "the sender speaks version {version} of the protocol, this program version {VERSION}: use the singletrack of its release"
            );
            return Some(broken("version", detail, &self.bytes));
        }
        Some(content)
    }

    fn end_stretch(&mut self, content: Option<Content>) -> Option<Found> {
        let offset = self.begin;
        self.begin = self.taken;
        self.bytes.clear();
        let content = content?;
        self.whole += u64::from(!matches!(content, Content::Broken(_)));
        Some(Found {
            offset,
            length: self.taken - offset,
            content,
        })
    }
}

/// The bytes of the line can't be read.
fn unreadable(name: &str, error: &io::Error) -> DumpError {
    DumpError::Other(format!("can't read {name}: {error}"))
}

impl Source for Line<'_> {
    fn start_wall_ns(&self) -> Option<u64> {
        match self.clock {
            Clock::Arrival { start_wall_ns, .. } => start_wall_ns,
            Clock::Board { .. } => None,
        }
    }

    fn next(&mut self) -> Result<Next, DumpError> {
        let Some(found) = self.search() else {
            if !self.ended {
                return Ok(Next::Pending);
            }
            if matches!(self.input, Input::File(_)) && self.whole == 0 {
                let Self { name, taken, .. } = self;
                return Err(DumpError::Other(format!(
                    "{name} holds no whole frame of the protocol in {taken} bytes: name a capture of \
                     the serial line (--direction says which way the bytes went), or a record (*.mcap \
                     or *.mcap.part)"
                )));
            }
            return Ok(Next::End);
        };
        let (name, _) = found.content.message();
        let kind = self.kinds.iter().position(|kind| kind.name == name);
        let time_ns = self.clock.date(&found.content);
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
                Err(unreadable(&self.name, &error))
            }
            _ => Ok(()),
        }
    }

    fn take_message(&mut self, take: &mut dyn FnMut(Message<'_>)) -> Result<(), DumpError> {
        if let Some(found) = &self.found {
            take(Message::Frame(&found.content));
        }
        Ok(())
    }

    fn read_values(&mut self, values: &mut Vec<Value>) -> Result<(), DumpError> {
        values.clear();
        if let Some(found) = &self.found {
            values.extend([found.offset, found.length].map(Value::Unsigned));
            let (_, message) = found.content.message();
            message.fields(&mut |_, value| values.push(value));
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
