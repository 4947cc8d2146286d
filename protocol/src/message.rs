//! The messages of both directions, with encoding and decoding.

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{
    Acknowledgement, Arm, Configuration, Disarm, Drive, EmergencyStop, Hello, Refusal, Sequence,
    Status, Telemetry,
    codec::{Field, Reader},
    frame::{Frame, MAX_PAYLOAD_LENGTH, Packet},
};

/// Sends calibration and limits to the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Configure {
    /// Number of this request, repeated in the answer.
    pub request: Sequence,
    /// The complete configuration; it replaces an earlier one.
    pub configuration: Configuration,
}

/// The first byte of every packet.
///
/// The two directions share only [`MessageType::Hello`], so that an echo is not
/// mistaken for the other end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum MessageType {
    /// [`Hello`], in both directions; never changes.
    Hello = 0x01,
    /// [`Configure`], to the board.
    Configure = 0x10,
    /// [`Arm`], to the board.
    Arm = 0x11,
    /// [`Disarm`], to the board.
    Disarm = 0x12,
    /// [`Drive`], to the board.
    Drive = 0x13,
    /// [`EmergencyStop`], to the board.
    EmergencyStop = 0x14,
    /// [`Telemetry`], to the host.
    Telemetry = 0x20,
    /// [`Status`], to the host.
    Status = 0x21,
    /// [`Acknowledgement`], to the host.
    Acknowledgement = 0x22,
    /// [`Refusal`], to the host.
    Refusal = 0x23,
}

/// A message with its type byte and the fixed length of its payload.
pub trait Message: Field + Serialize + DeserializeOwned {
    /// First byte of its packets.
    const TYPE: MessageType;
    /// Length of its payload, in bytes.
    const PAYLOAD_LENGTH: usize;

    /// Encodes this message as a frame, by the board's codec.
    #[must_use]
    fn encode(&self) -> Frame {
        let mut frame = Frame::new();
        self.encode_into(&mut frame);
        frame
    }

    /// Encodes this message into `frame`; unlike [`Message::encode`], without
    /// copying a return value.
    fn encode_into(&self, frame: &mut Frame) {
        frame.build(Self::TYPE as u8, self);
    }
}

macro_rules! messages {
    ($($message:ident: $length:literal,)*) => {$(
        impl Message for $message {
            const TYPE: MessageType = MessageType::$message;
            const PAYLOAD_LENGTH: usize = $length;
        }
        const _: () = assert!($length <= MAX_PAYLOAD_LENGTH);
    )*};
}

messages! {
    Hello: 9,
    Configure: 41,
    Arm: 9,
    Disarm: 1,
    Drive: 11,
    EmergencyStop: 1,
    Telemetry: 35,
    Status: 25,
    Acknowledgement: 6,
    Refusal: 3,
}

/// Errors while decoding a valid packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// No message in this direction has this type byte.
    #[error("unknown type byte {0:#04x} in this direction: the other side uses another version")]
    UnknownType(u8),
    /// The length of the payload does not match the message.
    #[error(
        "the payload of {message:?} has {actual} bytes instead of {expected}: the other side uses another version"
    )]
    Length {
        /// The message of the type byte.
        message: MessageType,
        /// Length of its payload, in bytes.
        expected: usize,
        /// Received length, in bytes.
        actual: usize,
    },
    /// A Boolean or an enumeration has an invalid number.
    #[error("invalid number in a field of {message:?}: the other side uses another version")]
    Value {
        /// The message of the type byte.
        message: MessageType,
    },
}

// The host encodes and decodes with postcard. The board has no room for postcard
// and uses `codec`, which gives the same bytes. Each implementation therefore reads
// what the other writes.

fn encode_by_postcard<M: Message>(message: &M) -> Frame {
    Frame::filled(M::TYPE as u8, |buffer| {
        // Every message fits in the buffer.
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
            /// Encodes this message as a frame.
            #[must_use]
            pub fn encode(&self) -> Frame {
                match self {
                    $(Self::$message(message) => $encode(message),)*
                }
            }

            /// Decodes a packet.
            ///
            /// # Errors
            ///
            /// If the type does not belong to this direction, or length or contents
            /// do not match the type.
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
    /// Messages from the host.
    ToBoard: encode_by_postcard, decode_by_fields {
        /// Greets; the board answers with its own greeting.
        Hello,
        /// Configures the board.
        Configure,
        /// Enables commands.
        Arm,
        /// Disables commands.
        Disarm,
        /// Commands speed and steering.
        Drive,
        /// Stops the car until a reset.
        EmergencyStop,
    }
}

direction! {
    /// Messages from the board.
    ToHost: encode_by_fields, decode_by_postcard {
        /// Answers a greeting, or announces a start of the board.
        Hello,
        /// Measurements for control.
        Telemetry,
        /// Diagnostics.
        Status,
        /// Confirms a request.
        Acknowledgement,
        /// Rejects a request.
        Refusal,
    }
}
