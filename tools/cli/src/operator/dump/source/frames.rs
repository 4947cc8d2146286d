//! Frames out of the bytes of the line, whole and broken ones.

use clap::ValueEnum;
use singletrack_protocol::{
    Acknowledgement, Arm, Configure, DecodeError, Decoder, Disarm, Drive, EmergencyStop,
    FrameError, Hello, Identity, Jog, MAX_PAYLOAD_LENGTH, Message, Packet, Refusal, Status,
    Telemetry, ToBoard, ToHost, VERSION,
};
use singletrack_record::{Entry, StatusRecord, TelemetryRecord, Topic, Value};

use crate::operator::dump::kind::{Kind, TELEMETRY};

/// Which way the bytes went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Direction {
    /// From the board to the host: what a serial port receives.
    #[default]
    ToHost,
    /// From the host to the board.
    ToBoard,
}

/// The kind of bytes that are not a frame.
pub(in crate::operator::dump) const BROKEN: &str = "broken";

/// No more bytes than this of something broken are shown.
const SHOWN_BYTES: usize = 64;

/// A stretch of bytes up to a zero.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Found {
    /// Where it begins, in bytes from the start.
    pub(super) offset: u64,
    /// How many bytes it has, with the zero that ends it.
    pub(super) length: u64,
    /// What it says.
    pub(super) content: Content,
}

/// What a stretch of bytes says.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Content {
    /// A message of the board.
    ToHost(ToHost),
    /// A message of the host.
    ToBoard(ToBoard),
    /// Nothing.
    Broken {
        /// Why, in a word.
        reason: &'static str,
        /// Why, in a sentence.
        detail: String,
        /// Its first bytes.
        bytes: Vec<u8>,
    },
}

/// Finds frames in bytes, and says where they are.
pub(super) struct Frames {
    direction: Direction,
    decoder: Decoder,
    /// Bytes taken.
    taken: u64,
    /// Where the stretch that is being taken begins.
    begin: u64,
    /// Its first bytes.
    bytes: Vec<u8>,
    /// The version in the last greeting, if it is not ours.
    other_version: Option<u16>,
    /// How many frames were whole.
    pub(super) whole: u64,
}

impl Frames {
    pub(super) fn new(direction: Direction) -> Self {
        Self {
            direction,
            decoder: Decoder::new(),
            taken: 0,
            begin: 0,
            bytes: Vec::new(),
            other_version: None,
            whole: 0,
        }
    }

    /// Bytes taken.
    pub(super) const fn taken(&self) -> u64 {
        self.taken
    }

    /// Takes a byte; the last of a stretch gives what the stretch is.
    pub(super) fn push(&mut self, byte: u8) -> Option<Found> {
        self.taken += 1;
        if byte == 0 {
            let (other_version, bytes) = (&mut self.other_version, &self.bytes);
            let content = self.decoder.push(byte).map(|decoded| match decoded {
                Ok(packet) => understand(self.direction, packet, other_version, bytes),
                Err(error) => broken(frame_error(error), error.to_string(), bytes),
            });
            return self.found(content);
        }
        self.decoder.push_data(byte);
        if self.bytes.len() < SHOWN_BYTES {
            self.bytes.push(byte);
        }
        None
    }

    /// The stretch at the end of the bytes that no zero ends.
    pub(super) fn finish(&mut self) -> Option<Found> {
        let content = (self.taken > self.begin).then(|| {
            let detail = "the bytes end in the middle of a frame".to_owned();
            broken("unfinished", detail, &self.bytes)
        });
        self.found(content)
    }

    fn found(&mut self, content: Option<Content>) -> Option<Found> {
        let offset = self.begin;
        self.begin = self.taken;
        self.bytes.clear();
        let content = content?;
        self.whole += u64::from(!matches!(content, Content::Broken { .. }));
        Some(Found {
            offset,
            length: self.taken - offset,
            content,
        })
    }
}

/// The message of a good packet. After a greeting in another version nothing else
/// is believed, however well it looks.
fn understand(
    direction: Direction,
    packet: Packet<'_>,
    other_version: &mut Option<u16>,
    bytes: &[u8],
) -> Content {
    let message = match direction {
        Direction::ToHost => ToHost::decode(packet).map(Content::ToHost),
        Direction::ToBoard => ToBoard::decode(packet).map(Content::ToBoard),
    };
    if let Ok(Content::ToHost(ToHost::Hello(hello)) | Content::ToBoard(ToBoard::Hello(hello))) =
        &message
    {
        *other_version = (hello.protocol_version != VERSION).then_some(hello.protocol_version);
    } else if let Some(version) = other_version {
        let detail = format!(
            "the sender speaks version {version} of the protocol, this program version {VERSION}: use the singletrack of its release"
        );
        return broken("version", detail, bytes);
    }
    message.unwrap_or_else(|error| {
        let reason = match error {
            DecodeError::UnknownType(_) => "unknown-type",
            DecodeError::Length { .. } => "payload-length",
            DecodeError::Value { .. } => "payload-value",
        };
        broken(reason, error.to_string(), bytes)
    })
}

const fn frame_error(error: FrameError) -> &'static str {
    match error {
        FrameError::Truncated => "truncated",
        FrameError::TooLong => "too-long",
        FrameError::TooShort(_) => "too-short",
        FrameError::CheckSum => "check-sum",
    }
}

fn broken(reason: &'static str, detail: String, bytes: &[u8]) -> Content {
    Content::Broken {
        reason,
        detail,
        bytes: bytes.to_owned(),
    }
}

impl Content {
    /// An example of every type of frame in a direction.
    fn examples(direction: Direction) -> Vec<Self> {
        // Zeros are a payload of every message.
        let zeros = [0; MAX_PAYLOAD_LENGTH];
        let packets = match direction {
            Direction::ToHost => vec![
                zero::<Hello>(&zeros),
                zero::<Telemetry>(&zeros),
                zero::<Status>(&zeros),
                zero::<Acknowledgement>(&zeros),
                zero::<Refusal>(&zeros),
                zero::<Identity>(&zeros),
            ],
            Direction::ToBoard => vec![
                zero::<Hello>(&zeros),
                zero::<Configure>(&zeros),
                zero::<Arm>(&zeros),
                zero::<Disarm>(&zeros),
                zero::<Drive>(&zeros),
                zero::<EmergencyStop>(&zeros),
                zero::<Jog>(&zeros),
            ],
        };
        let understood = packets
            .into_iter()
            .map(|packet| understand(direction, packet, &mut None, &[]));
        understood.chain([broken("", String::new(), &[])]).collect()
    }

    /// The name of its kind.
    pub(super) const fn name(&self) -> &'static str {
        match self {
            Self::ToHost(ToHost::Hello(_)) | Self::ToBoard(ToBoard::Hello(_)) => "hello",
            Self::ToHost(ToHost::Telemetry(_)) => Topic::Telemetry.name(),
            Self::ToHost(ToHost::Status(_)) => Topic::Status.name(),
            Self::ToHost(ToHost::Acknowledgement(_)) => "acknowledgement",
            Self::ToHost(ToHost::Refusal(_)) => "refusal",
            Self::ToHost(ToHost::Identity(_)) => "identity",
            Self::ToBoard(ToBoard::Configure(_)) => "configure",
            Self::ToBoard(ToBoard::Arm(_)) => "arm",
            Self::ToBoard(ToBoard::Disarm(_)) => "disarm",
            Self::ToBoard(ToBoard::Drive(_)) => "drive",
            Self::ToBoard(ToBoard::EmergencyStop(_)) => "emergency-stop",
            Self::ToBoard(ToBoard::Jog(_)) => "jog",
            Self::Broken { .. } => BROKEN,
        }
    }

    /// The board's clock when it was made, as far as it says: in µs, wrapping.
    pub(super) const fn board_time_us(&self) -> Option<u32> {
        match self {
            Self::ToHost(ToHost::Telemetry(telemetry)) => Some(telemetry.board_time_us),
            Self::ToHost(ToHost::Status(status)) => Some(status.board_time_us),
            Self::ToBoard(ToBoard::Drive(drive)) => Some(drive.telemetry_time_us),
            Self::ToBoard(ToBoard::Jog(jog)) => Some(jog.telemetry_time_us),
            Self::ToBoard(ToBoard::Arm(arm)) => Some(arm.telemetry_time_us),
            _ => None,
        }
    }

    /// Its fields, by name.
    fn fields(&self, field: &mut dyn FnMut(&str, Value)) {
        let number = |value: u32| Value::Unsigned(value.into());
        let text = |text: String| Value::Text(text.into());
        let word = |word: &'static str| Value::Text(word.into());
        match self {
            Self::ToHost(ToHost::Hello(hello)) | Self::ToBoard(ToBoard::Hello(hello)) => {
                let [major, minor, patch] = hello.software_version;
                field("protocol_version", number(hello.protocol_version.into()));
                field("software_version", text(format!("{major}.{minor}.{patch}")));
                field("nonce", number(hello.nonce));
            }
            Self::ToHost(ToHost::Telemetry(telemetry)) => {
                let record = TelemetryRecord {
                    receive_time_ns: 0,
                    board_time_host_ns: 0,
                    imu_time_host_ns: None,
                    telemetry: *telemetry,
                };
                recorded(&Entry::Telemetry(record), field);
            }
            Self::ToHost(ToHost::Status(status)) => {
                let record = StatusRecord {
                    receive_time_ns: 0,
                    status: *status,
                };
                recorded(&Entry::Status(record), field);
            }
            Self::ToHost(ToHost::Acknowledgement(answer)) => {
                field("request", word(answer.request.name()));
                field("sequence", number(answer.sequence.0.into()));
                field("configuration_hash", number(answer.configuration_hash));
            }
            Self::ToHost(ToHost::Refusal(answer)) => {
                field("request", word(answer.request.name()));
                field("sequence", number(answer.sequence.0.into()));
                field("reason", word(answer.reason.name()));
            }
            Self::ToHost(ToHost::Identity(identity)) => {
                field("car_id", number(identity.car_id.into()));
            }
            Self::ToBoard(ToBoard::Configure(configure)) => {
                let configuration = &configure.configuration;
                let (servo, esc) = (&configuration.servo, &configuration.esc);
                let speed = &configuration.speed;
                field("request", number(configure.request.0.into()));
                field("configuration_hash", number(configuration.hash()));
                field("esc.kind", word(esc.kind.name()));
                for (name, value) in [
                    ("servo.centre_us", i64::from(servo.centre_us)),
                    ("servo.gain_us_per_rad", servo.gain_us_per_rad.into()),
                    ("servo.min_us", servo.min_us.into()),
                    ("servo.max_us", servo.max_us.into()),
                    ("servo.slew_us_per_20ms", servo.slew_us_per_20ms.into()),
                    ("esc.neutral_us", esc.neutral_us.into()),
                    ("esc.deadband_us", esc.deadband_us.into()),
                    ("esc.min_us", esc.min_us.into()),
                    ("esc.max_us", esc.max_us.into()),
                    ("esc.slew_us_per_20ms", esc.slew_us_per_20ms.into()),
                    ("esc.brake_us", esc.brake_us.into()),
                    ("speed.pulse_distance_um", speed.pulse_distance_um.into()),
                    (
                        "speed.feed_forward_us_per_m_s",
                        speed.feed_forward_us_per_m_s.into(),
                    ),
                    (
                        "speed.proportional_us_per_m_s",
                        speed.proportional_us_per_m_s.into(),
                    ),
                    ("speed.integral_us_per_m", speed.integral_us_per_m.into()),
                    ("speed.integral_limit_us", speed.integral_limit_us.into()),
                    ("speed.max_forward_mm_s", speed.max_forward_mm_s.into()),
                    ("speed.max_reverse_mm_s", speed.max_reverse_mm_s.into()),
                ] {
                    field(name, Value::Signed(value));
                }
                field("failsafe", word(configuration.failsafe.name()));
                field(
                    "max_pose_age_ms",
                    number(configuration.max_pose_age_ms.into()),
                );
                field("stop_input", Value::Bool(configuration.stop_input));
                field("kill_output", Value::Bool(configuration.kill_output));
                field(
                    "max_roll_out_ms",
                    number(configuration.max_roll_out_ms.into()),
                );
                field("car_id", number(configuration.car_id.into()));
                for (name, axis) in [
                    ("imu_axes.forward", configuration.imu_axes.forward),
                    ("imu_axes.left", configuration.imu_axes.left),
                    ("imu_axes.up", configuration.imu_axes.up),
                ] {
                    field(name, word(axis.name()));
                }
            }
            Self::ToBoard(ToBoard::Arm(arm)) => {
                field("request", number(arm.request.0.into()));
                field("configuration_hash", number(arm.configuration_hash));
                field("telemetry_time_us", number(arm.telemetry_time_us));
            }
            Self::ToBoard(ToBoard::Disarm(disarm)) => {
                field("request", number(disarm.request.0.into()));
            }
            Self::ToBoard(ToBoard::Drive(drive)) => {
                field("sequence", number(drive.sequence.0.into()));
                field("speed_mm_s", Value::Signed(drive.speed_mm_s.into()));
                field(
                    "steering_100urad",
                    Value::Signed(drive.steering_100urad.into()),
                );
                field("telemetry_time_us", number(drive.telemetry_time_us));
                field("pose_age_ms", number(drive.pose_age_ms.into()));
                field("brake", Value::Bool(drive.brake));
            }
            Self::ToBoard(ToBoard::EmergencyStop(stop)) => {
                field("request", number(stop.request.0.into()));
            }
            Self::ToBoard(ToBoard::Jog(jog)) => {
                field("sequence", number(jog.sequence.0.into()));
                field("telemetry_time_us", number(jog.telemetry_time_us));
                field("servo_us", number(jog.servo_us.into()));
                field("esc_us", number(jog.esc_us.into()));
            }
            Self::Broken {
                reason,
                detail,
                bytes,
            } => {
                field("reason", word(reason));
                field("detail", text(detail.clone()));
                field("bytes", text(hexadecimal(bytes)));
            }
        }
    }
}

impl Found {
    /// Replaces `values` with its fields, in the order of its kind.
    pub(super) fn read_values(&self, values: &mut Vec<Value>) {
        values.clear();
        values.extend([Value::Unsigned(self.offset), Value::Unsigned(self.length)]);
        self.content.fields(&mut |_, value| values.push(value));
    }
}

/// The kinds of frames in a direction. Every frame has an offset and a length.
pub(in crate::operator::dump) fn kinds(direction: Direction) -> Vec<Kind> {
    Content::examples(direction)
        .iter()
        .map(|example| {
            let mut fields = vec!["offset".to_owned(), "length".to_owned()];
            example.fields(&mut |name, _| fields.push(name.to_owned()));
            Kind {
                name: example.name(),
                fields,
                brief: match example {
                    Content::ToHost(ToHost::Telemetry(_)) => {
                        [&["offset", "length", "board_time_us"], TELEMETRY].concat()
                    }
                    _ => Vec::new(),
                },
            }
        })
        .collect()
}

/// The fields of a record's entry that come over the line: all from the board's
/// clock on. The host adds those before.
fn recorded(entry: &Entry, field: &mut dyn FnMut(&str, Value)) {
    let names = entry.topic().fields();
    for (name, value) in names
        .iter()
        .zip(entry.values())
        .skip_while(|(name, _)| *name != "board_time_us")
    {
        field(name, value);
    }
}

/// A packet with a message of zeros.
fn zero<M: Message>(zeros: &[u8]) -> Packet<'_> {
    Packet {
        kind: M::TYPE as u8,
        payload: zeros.get(..M::PAYLOAD_LENGTH).unwrap_or(zeros),
    }
}

/// `0a ff 13`; with an ellipsis if there may be more.
fn hexadecimal(bytes: &[u8]) -> String {
    let mut words: Vec<_> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    if bytes.len() == SHOWN_BYTES {
        words.push("...".to_owned());
    }
    words.join(" ")
}
