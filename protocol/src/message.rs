//! The two sets of messages, and their way into frames and out of packets; the greeting, whose layout
//! never changes; and the load of the serial line, checked at compile time.

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{
    Acknowledgement, Configuration, Refusal, STATUS_PERIOD_US, Status, TELEMETRY_PERIOD_US,
    Telemetry,
    codec::{Field, Reader, Writer, structure},
    frame::{Frame, MAX_FRAME_LENGTH, MAX_PAYLOAD_LENGTH, Packet, frame_length},
};

structure! {
    /// Gives the board its calibration and limits.
    pub struct Configure {
        /// Names this request in the answer.
        pub request: Sequence,
        /// What the board is to use from now on, whole: nothing is kept of an
        /// earlier one.
        pub configuration: Configuration,
    }
}

/// A message with its type byte and the one length its payload can have.
pub trait Message: Field + Serialize + DeserializeOwned {
    /// The byte that begins its packets.
    const TYPE: MessageType;
    /// The length of its payload, in bytes.
    const PAYLOAD_LENGTH: usize;

    /// The frame that carries this message, as the board makes it.
    fn encode(&self) -> Frame {
        let mut frame = Frame::new();
        self.encode_into(&mut frame);
        frame
    }

    /// Makes `frame` the one that carries this message: the same as
    /// [`Message::encode`], without the copy that a return value can cost.
    fn encode_into(&self, frame: &mut Frame) {
        frame.build(Self::TYPE as u8, self);
    }
}

/// Declares the messages: each with its type byte, and the length of its payload in bytes.
macro_rules! messages {
    ($($(#[$about:meta])* $message:ident = $number:literal: $length:literal,)*) => {
        /// The byte that begins every packet.
        ///
        /// The two directions share none but [`MessageType::Hello`], so that a line
        /// that echoes is not taken for a partner.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum MessageType {
            $($(#[$about])* $message = $number,)*
        }

        $(
            impl Message for $message {
                const TYPE: MessageType = MessageType::$message;
                const PAYLOAD_LENGTH: usize = $length;
            }
            const _: () = assert!($length <= MAX_PAYLOAD_LENGTH);
        )*
    };
}

messages! {
    /// [`Hello`], both ways; frozen for ever.
    Hello = 0x01: 9,
    /// [`Configure`], to the board.
    Configure = 0x10: 50,
    /// [`Arm`], to the board.
    Arm = 0x11: 9,
    /// [`Disarm`], to the board.
    Disarm = 0x12: 1,
    /// [`Drive`], to the board.
    Drive = 0x13: 12,
    /// [`EmergencyStop`], to the board.
    EmergencyStop = 0x14: 1,
    /// [`Jog`], to the board.
    Jog = 0x15: 9,
    /// [`Telemetry`], to the host.
    Telemetry = 0x20: 35,
    /// [`Status`], to the host.
    Status = 0x21: 35,
    /// [`Acknowledgement`], to the host.
    Acknowledgement = 0x22: 6,
    /// [`Refusal`], to the host.
    Refusal = 0x23: 3,
    /// [`Identity`], to the host.
    Identity = 0x24: 2,
}

/// Why a good packet is not a message that this version understands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// No message in this direction has this type byte.
    #[error(
        "no message in this direction has the type byte {0:#04x}: the other side speaks another version"
    )]
    UnknownType(u8),
    /// The payload has not the one length that the message can have.
    #[error(
        "the payload of {message:?} is {actual} bytes instead of {expected}: the other side speaks another version"
    )]
    Length {
        /// The message named by the type byte.
        message: MessageType,
        /// The length that its payload must have, in bytes.
        expected: usize,
        /// The length that it had, in bytes.
        actual: usize,
    },
    /// A truth value or an enumeration holds a number that means nothing.
    #[error(
        "a field of {message:?} holds a number without a meaning: the other side speaks another version"
    )]
    Value {
        /// The message named by the type byte.
        message: MessageType,
    },
}

// The host's end passes payloads through postcard. The board's end has no room for
// that and passes the same bytes field by field, see `codec`: so whatever one end
// writes, the other implementation reads.

fn encode_by_postcard<M: Message>(message: &M) -> Frame {
    Frame::filled(M::TYPE as u8, |buffer| {
        // The buffer has room for every message.
        postcard::to_slice(message, buffer).map_or(0, |payload| payload.len())
    })
}

fn encode_by_fields<M: Message>(message: &M) -> Frame {
    message.encode()
}

fn decode_by_postcard<M: Message>(payload: &[u8]) -> Result<M, DecodeError> {
    check_length::<M>(payload)?;
    match postcard::take_from_bytes(payload) {
        Ok((message, [])) => Ok(message),
        _ => Err(DecodeError::Value { message: M::TYPE }),
    }
}

fn decode_by_fields<M: Message>(payload: &[u8]) -> Result<M, DecodeError> {
    check_length::<M>(payload)?;
    let mut reader = Reader::new(payload);
    let message = M::read(&mut reader);
    if reader.finish() {
        Ok(message)
    } else {
        Err(DecodeError::Value { message: M::TYPE })
    }
}

fn check_length<M: Message>(payload: &[u8]) -> Result<(), DecodeError> {
    if payload.len() == M::PAYLOAD_LENGTH {
        return Ok(());
    }
    Err(DecodeError::Length {
        message: M::TYPE,
        expected: M::PAYLOAD_LENGTH,
        actual: payload.len(),
    })
}

macro_rules! direction {
    (
        $(#[$documentation:meta])*
        $name:ident: $encode:ident, $decode:ident {
            $($(#[$meaning:meta])* $message:ident,)*
        }
    ) => {
        $(#[$documentation])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $($(#[$meaning])* $message($message),)*
        }

        impl $name {
            /// The frame that carries this message.
            pub fn encode(&self) -> Frame {
                match self {
                    $(Self::$message(message) => $encode(message),)*
                }
            }

            /// The message that a packet carries.
            ///
            /// # Errors
            ///
            /// When the type is not one of this direction, or when length or
            /// contents are not those of the type.
            pub fn decode(packet: Packet<'_>) -> Result<Self, DecodeError> {
                $(if packet.kind == MessageType::$message as u8 {
                    return $decode(packet.payload).map(Self::$message);
                })*
                Err(DecodeError::UnknownType(packet.kind))
            }
        }

        $(impl From<$message> for $name {
            fn from(message: $message) -> Self {
                Self::$message(message)
            }
        })*
    };
}

direction! {
    /// What the host sends.
    ToBoard: encode_by_postcard, decode_by_fields {
        /// Greets, and asks for the board's greeting.
        Hello,
        /// Asks the board to take over a configuration.
        Configure,
        /// Asks the board to accept commands.
        Arm,
        /// Asks the board to stop accepting commands.
        Disarm,
        /// Commands speed and steering.
        Drive,
        /// Stops until reset.
        EmergencyStop,
        /// Commands bare pulses.
        Jog,
    }
}

direction! {
    /// What the board sends.
    ToHost: encode_by_fields, decode_by_postcard {
        /// Answers a greeting, or announces a start.
        Hello,
        /// The record for control.
        Telemetry,
        /// The record for people.
        Status,
        /// Yes, to a request.
        Acknowledgement,
        /// No, to a request.
        Refusal,
        /// Which car the board is built into; follows its every greeting.
        Identity,
    }
}

/// The nonce of the [`Hello`] that the board sends at its start, unsolicited.
pub const UNSOLICITED: u32 = 0;

structure! {
    /// Who is speaking, in a layout that never changes.
    ///
    /// The host sends it with a non-zero nonce; the board answers with its own
    /// versions and the same nonce. The board also sends one with the nonce
    /// [`UNSOLICITED`] when it starts, from which the host learns that all state on the
    /// board is lost.
    pub struct Hello {
        /// The speaker's [`crate::VERSION`].
        pub protocol_version: u16,
        /// The speaker's software version: major, minor, patch.
        pub software_version: [u8; 3],
        /// Chosen by the host, repeated by the board; [`UNSOLICITED`] at start-up.
        pub nonce: u32,
    }
}

/// The number of a board that has been given none.
pub const UNNAMED: u16 = 0;

structure! {
    /// Which car the board is built into: sent right after every [`Hello`] of the
    /// board, whose own layout never changes.
    pub struct Identity {
        /// The number that the image was built with; [`UNNAMED`] for none.
        pub car_id: u16,
    }
}

/// 115200 baud, a start and a stop bit around every byte.
const LINE_BYTES_PER_S: u32 = 11_520;

/// Largest share of the line for periodic traffic. The rest is for answers, for a
/// clock that is 2 % off, and for catching up after a gap.
const LOAD_LIMIT_PERCENT: u32 = 40;

/// The board's receive buffer, in bytes.
pub const RECEIVE_BUFFER_LENGTH: usize = 128;

// In `u32`: `usize` has 16 bits on the board.
const fn bytes_per_s(payload_length: usize, period_us: u32) -> u32 {
    frame_length(payload_length) as u32 * (1_000_000 / period_us)
}

const TO_HOST_BYTES_PER_S: u32 = bytes_per_s(Telemetry::PAYLOAD_LENGTH, TELEMETRY_PERIOD_US)
    + bytes_per_s(Status::PAYLOAD_LENGTH, STATUS_PERIOD_US);

// The host commands once per telemetry record.
const TO_BOARD_BYTES_PER_S: u32 = bytes_per_s(Drive::PAYLOAD_LENGTH, TELEMETRY_PERIOD_US);

// A jog takes the place of a drive command.
const _: () = assert!(Jog::PAYLOAD_LENGTH <= Drive::PAYLOAD_LENGTH);

const _: () = assert!(TO_HOST_BYTES_PER_S * 100 <= LINE_BYTES_PER_S * LOAD_LIMIT_PERCENT);
const _: () = assert!(TO_BOARD_BYTES_PER_S * 100 <= LINE_BYTES_PER_S * LOAD_LIMIT_PERCENT);

// The longest frame, and the bytes that arrive in 5 ms, the longest time that an
// IMU transfer and a telemetry record keep the main loop busy.
const _: () =
    assert!(RECEIVE_BUFFER_LENGTH >= MAX_FRAME_LENGTH + (LINE_BYTES_PER_S * 5 / 1_000) as usize);

/// A wrapping sequence number; the newest wins, duplicates and older ones are
/// refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sequence(pub u8);

impl Sequence {
    /// The number after this one.
    #[must_use]
    pub const fn next(self) -> Self {
        Self(self.0.wrapping_add(1))
    }

    /// Whether this number comes after `other`, by at most 127 steps.
    pub const fn is_newer_than(self, other: Self) -> bool {
        matches!(self.0.wrapping_sub(other.0), 1..=127)
    }
}

impl Field for Sequence {
    fn write(&self, writer: &mut Writer<'_>) {
        self.0.write(writer);
    }

    fn read(reader: &mut Reader<'_>) -> Self {
        Self(u8::read(reader))
    }
}

structure! {
    /// Asks the board to accept [`Drive`] commands from now on.
    pub struct Arm {
        /// Names this request in the answer.
        pub request: Sequence,
        /// [`crate::Configuration::hash`] of the configuration that the host
        /// believes the board has.
        pub configuration_hash: u32,
        /// Board time of the newest telemetry that the host has seen. A request
        /// that has waited in a stuck line must not arm the car.
        pub telemetry_time_us: u32,
    }
}

structure! {
    /// Asks the board to go to neutral and to refuse [`Drive`] commands.
    pub struct Disarm {
        /// Names this request in the answer.
        pub request: Sequence,
    }
}

structure! {
    /// Asks the board to go to neutral and to stay there until it is reset.
    pub struct EmergencyStop {
        /// Names this request in the answer.
        pub request: Sequence,
    }
}

structure! {
    /// Steering and speed, with the two ages that let the board judge them.
    ///
    /// Not acknowledged: [`crate::Telemetry::last_sequence`] states what the board
    /// accepted.
    pub struct Drive {
        /// Newest wins.
        pub sequence: Sequence,
        /// Speed of the rear axle along the car, forward positive, in mm/s.
        pub speed_mm_s: i16,
        /// Steering angle of the front wheels, left positive, in units of 100 µrad.
        pub steering_100urad: i16,
        /// Board time of the newest telemetry that the host had seen: the board
        /// measures with its own clock how old this command is.
        pub telemetry_time_us: u32,
        /// Age, at `telemetry_time_us`, of the pose behind this command: the
        /// mid-exposure of the last pose that was *accepted*, which neither holding
        /// nor coasting renews. In milliseconds, rounded up; `u16::MAX` for none.
        pub pose_age_ms: u16,
        /// Brake down to `speed_mm_s` where the ESC can: the host is stopping the
        /// car. Without it, a car that is too fast gets neutral.
        pub brake: bool,
    }
}

structure! {
    /// Bare pulses, to find out what servo and ESC do with them. The board clamps
    /// them to its limits and to [`JOG_LIMIT_US`](crate::JOG_LIMIT_US); what it
    /// gives is in [`crate::Telemetry`].
    ///
    /// Accepted instead of [`Drive`]: an armed board takes one or the other until it
    /// is disarmed. It rests on no pose. Not acknowledged, as [`Drive`].
    pub struct Jog {
        /// Newest wins; the same numbers as those of [`Drive`].
        pub sequence: Sequence,
        /// Board time of the newest telemetry that the host had seen.
        pub telemetry_time_us: u32,
        /// Servo pulse, in µs.
        pub servo_us: u16,
        /// ESC pulse, in µs.
        pub esc_us: u16,
    }
}
