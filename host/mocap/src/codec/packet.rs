//! The header of a datagram, separate from its payload.

use super::{error::DecodeError, reader::Reader};

/// Length of the header: message id and payload length.
pub const HEADER_LEN: usize = 4;

/// The largest payload that UDP over IPv4 carries, in bytes; no NatNet message
/// is longer.
pub const MAX_DATAGRAM_LEN: usize = 65_507;

/// The NatNet messages that this crate knows, by their id on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u16)]
#[non_exhaustive]
pub enum MessageId {
    /// Client to server: connect.
    Connect = 0,
    /// Answer to [`Connect`](Self::Connect).
    ServerInfo = 1,
    /// Client to server: a text command.
    Request = 2,
    /// Answer to [`Request`](Self::Request).
    Response = 3,
    /// Client to server: list the tracked models.
    RequestModelDefinitions = 4,
    /// Answer to [`RequestModelDefinitions`](Self::RequestModelDefinitions).
    ModelDefinitions = 5,
    /// One frame of poses.
    Frame = 7,
    /// Server to client: a text for people.
    MessageString = 8,
    /// Either side disconnects.
    Disconnect = 9,
    /// Client to server: keep streaming to me.
    KeepAlive = 10,
    /// Client to server: read the clock.
    EchoRequest = 12,
    /// Answer to [`EchoRequest`](Self::EchoRequest).
    EchoResponse = 13,
    /// Client to every server: find servers.
    Discovery = 14,
    /// The server did not understand a request.
    Unrecognized = 100,
}

impl MessageId {
    /// The message with this id; `None` for an unknown id.
    #[must_use]
    pub const fn from_wire(id: u16) -> Option<Self> {
        Some(match id {
            0 => Self::Connect,
            1 => Self::ServerInfo,
            2 => Self::Request,
            3 => Self::Response,
            4 => Self::RequestModelDefinitions,
            5 => Self::ModelDefinitions,
            7 => Self::Frame,
            8 => Self::MessageString,
            9 => Self::Disconnect,
            10 => Self::KeepAlive,
            12 => Self::EchoRequest,
            13 => Self::EchoResponse,
            14 => Self::Discovery,
            100 => Self::Unrecognized,
            _ => return None,
        })
    }
}

/// A datagram split into message id and raw payload; the payload is unchecked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    id: u16,
    payload: &'a [u8],
}

impl<'a> Packet<'a> {
    /// Splits a datagram.
    ///
    /// # Errors
    /// The datagram is shorter than the header, or its length is not what the
    /// header declares.
    pub fn parse(datagram: &'a [u8]) -> Result<Self, DecodeError> {
        let (packet, surplus) = Self::split(datagram)?;
        if surplus.is_empty() {
            Ok(packet)
        } else {
            Err(DecodeError::LengthMismatch {
                declared: packet.payload.len(),
                actual: packet.payload.len() + surplus.len(),
            })
        }
    }

    /// Splits a datagram into the packet its header declares and a surplus.
    pub(super) fn split(datagram: &'a [u8]) -> Result<(Self, &'a [u8]), DecodeError> {
        let mut reader = Reader::new(datagram, 0);
        let id = reader.u16("message id")?;
        let declared = usize::from(reader.u16("payload length")?);
        let actual = reader.remaining();
        if declared > actual {
            return Err(DecodeError::LengthMismatch { declared, actual });
        }
        let payload = reader.take(declared, "payload")?;
        let surplus = reader.take(reader.remaining(), "surplus")?;
        Ok((Self { id, payload }, surplus))
    }

    /// The message; `None` for an unknown id.
    #[must_use]
    pub const fn message_id(&self) -> Option<MessageId> {
        MessageId::from_wire(self.id)
    }

    /// The id on the wire.
    #[must_use]
    pub const fn raw_id(&self) -> u16 {
        self.id
    }

    /// The bytes after the header.
    #[must_use]
    pub const fn payload(&self) -> &'a [u8] {
        self.payload
    }

    pub(super) const fn reader(&self) -> Reader<'a> {
        Reader::new(self.payload, HEADER_LEN)
    }
}
