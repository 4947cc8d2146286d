//! Messages from a client.

use super::{
    error::DecodeError,
    packet::{MessageId, Packet},
    server::read_text,
    server_info::{SENDER_LEN, SENDER_NAME_LEN, name_prefix},
    version::{BitstreamVersion, UnsupportedVersion},
};

/// The longest known CONNECT: the sender block, a flag, a version, and up to two
/// further bytes that sample clients append.
const MAX_CONNECT_LEN: usize = SENDER_LEN + 1 + 4 + 2;

/// A message from a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ClientMessage<'a> {
    /// Asks the server to stream to this client and to identify itself.
    Connect(Connect<'a>),
    /// A text command, such as `Bitstream,4.1`: see [`bitstream_request`].
    Request(&'a str),
    /// Asks for the names and ids of the tracked models.
    RequestModelDefinitions,
    /// Asks the server to keep streaming.
    KeepAlive,
    /// The client disconnects.
    Disconnect,
    /// Asks for the server's clock.
    EchoRequest {
        /// The answer repeats it unchanged.
        client_stamp: u64,
    },
    /// Asks servers to identify themselves.
    Discovery,
}

/// The payload of CONNECT.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Connect<'a> {
    /// The client's name.
    pub name: &'a str,
    /// The requested bitstream, if any: the raw four bytes.
    pub requested_bitstream: Option<[u8; 4]>,
}

impl<'a> ClientMessage<'a> {
    /// Decodes a datagram from a client.
    ///
    /// One zero byte beyond the declared length is accepted: the vendor's own sample
    /// client sends it.
    ///
    /// # Errors
    /// What is wrong with the datagram, and where.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, DecodeError> {
        let (packet, surplus) = Packet::split(datagram)?;
        if !matches!(surplus, [] | [0]) {
            return Err(DecodeError::LengthMismatch {
                declared: packet.payload().len(),
                actual: packet.payload().len() + surplus.len(),
            });
        }
        let mut reader = packet.reader();
        Ok(match packet.message_id() {
            Some(MessageId::Connect) => Self::Connect(Connect::decode(&packet)?),
            Some(MessageId::Request) => Self::Request(read_text(&mut reader)?),
            Some(MessageId::RequestModelDefinitions) => Self::RequestModelDefinitions,
            Some(MessageId::KeepAlive) => Self::KeepAlive,
            Some(MessageId::Disconnect) => Self::Disconnect,
            Some(MessageId::Discovery) => Self::Discovery,
            Some(MessageId::EchoRequest) => {
                let client_stamp = reader.u64("echo client stamp")?;
                reader.finish("the echo request")?;
                Self::EchoRequest { client_stamp }
            }
            _ => {
                return Err(DecodeError::UnexpectedMessage {
                    id: packet.raw_id(),
                });
            }
        })
    }
}

impl<'a> Connect<'a> {
    /// Payloads of clients differ, down to an empty one: missing fields are allowed,
    /// and only a payload that is too long is an error.
    fn decode(packet: &Packet<'a>) -> Result<Self, DecodeError> {
        let payload = packet.payload();
        if payload.len() > MAX_CONNECT_LEN {
            return Err(DecodeError::UnexpectedLength {
                message: "CONNECT",
                actual: payload.len(),
            });
        }
        let name = payload.get(..SENDER_NAME_LEN).unwrap_or(payload);
        let requested_bitstream = payload
            .get(SENDER_LEN + 1..)
            .and_then(|rest| rest.first_chunk::<4>())
            .filter(|version| **version != [0; 4])
            .copied();
        Ok(Self {
            name: name_prefix(name),
            requested_bitstream,
        })
    }
}

/// The version that a text request such as `Bitstream,4.1` asks for; `None` when
/// the text is another command.
///
/// # Errors
/// The version is not supported. A version that is not two numbers counts as 0.0.
#[must_use]
pub fn bitstream_request(text: &str) -> Option<Result<BitstreamVersion, UnsupportedVersion>> {
    let (command, version) = text.split_once(',')?;
    if !command.eq_ignore_ascii_case("bitstream") {
        return None;
    }
    let mut numbers = version
        .trim()
        .split('.')
        .map(|number| number.parse::<u8>().unwrap_or_default());
    let major = numbers.next().unwrap_or_default();
    let minor = numbers.next().unwrap_or_default();
    Some(BitstreamVersion::new(major, minor))
}
