//! The header of a datagram, separate from its payload; the bounded little-endian cursor that reads
//! both, with its offset in the datagram; and why a datagram can't be decoded.

use super::BitstreamVersion;

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
        Self::parse_before(datagram, &[])
    }

    /// Splits a datagram that may have these bytes beyond the declared length.
    pub(super) fn parse_before(datagram: &'a [u8], surplus: &[u8]) -> Decoded<Self> {
        let mut reader = Reader::new(datagram, 0);
        let id = reader.u16("message id")?;
        let declared = usize::from(reader.u16("payload length")?);
        let actual = reader.remaining();
        match reader.rest.split_at_checked(declared) {
            Some((payload, rest)) if rest.is_empty() || rest == surplus => Ok(Self { id, payload }),
            _ => Err(DecodeError::LengthMismatch { declared, actual }),
        }
    }

    /// The message; `None` for an unknown id.
    pub const fn message_id(&self) -> Option<MessageId> {
        MessageId::from_wire(self.id)
    }

    /// The bytes after the header.
    pub const fn payload(&self) -> &'a [u8] {
        self.payload
    }

    pub(super) const fn reader(&self) -> Reader<'a> {
        Reader::new(self.payload, HEADER_LEN)
    }

    pub(super) const fn unexpected(&self) -> DecodeError {
        DecodeError::UnexpectedMessage { id: self.id }
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Reader<'a> {
    rest: &'a [u8],
    offset: usize,
}

impl<'a> Reader<'a> {
    /// A reader of `bytes`, which begin `offset` bytes into the datagram.
    pub(crate) const fn new(rest: &'a [u8], offset: usize) -> Self {
        Self { rest, offset }
    }

    pub(crate) const fn offset(&self) -> usize {
        self.offset
    }

    pub(crate) const fn remaining(&self) -> usize {
        self.rest.len()
    }

    pub(crate) fn take(&mut self, len: usize, field: &'static str) -> Decoded<&'a [u8]> {
        let Some((taken, rest)) = self.rest.split_at_checked(len) else {
            return Err(DecodeError::Truncated {
                field,
                offset: self.offset,
                needed: len,
                available: self.rest.len(),
            });
        };
        self.rest = rest;
        self.offset += len;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Decoded<[u8; N]> {
        // What is taken has this length.
        Ok(self.take(N, field)?.try_into().unwrap_or([0; N]))
    }

    pub(crate) fn bytes4(&mut self, field: &'static str) -> Decoded<[u8; 4]> {
        self.array(field)
    }

    pub(crate) fn u8(&mut self, field: &'static str) -> Decoded<u8> {
        let [byte] = self.array(field)?;
        Ok(byte)
    }

    pub(crate) fn u16(&mut self, field: &'static str) -> Decoded<u16> {
        self.array(field).map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self, field: &'static str) -> Decoded<u32> {
        self.array(field).map(u32::from_le_bytes)
    }

    pub(crate) fn i32(&mut self, field: &'static str) -> Decoded<i32> {
        self.array(field).map(i32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self, field: &'static str) -> Decoded<u64> {
        self.array(field).map(u64::from_le_bytes)
    }

    pub(crate) fn f32(&mut self, field: &'static str) -> Decoded<f32> {
        self.array(field).map(f32::from_le_bytes)
    }

    pub(crate) fn f64(&mut self, field: &'static str) -> Decoded<f64> {
        self.array(field).map(f64::from_le_bytes)
    }

    pub(crate) fn f32s<const N: usize>(&mut self, field: &'static str) -> Decoded<[f32; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f32(field)?;
        }
        Ok(values)
    }

    /// The bytes of a NUL-terminated string, without the NUL.
    pub(crate) fn c_bytes(&mut self, field: &'static str) -> Decoded<&'a [u8]> {
        let offset = self.offset;
        let Some(len) = self.rest.iter().position(|byte| *byte == 0) else {
            return Err(DecodeError::UnterminatedString { field, offset });
        };
        let bytes = self.take(len, field)?;
        self.take(1, field)?;
        Ok(bytes)
    }

    pub(crate) fn c_str(&mut self, field: &'static str) -> Decoded<&'a str> {
        let offset = self.offset;
        core::str::from_utf8(self.c_bytes(field)?)
            .map_err(|_| DecodeError::InvalidUtf8 { field, offset })
    }

    /// A count of entries of at least `min_entry_len` bytes each. A count that the
    /// remaining bytes can't hold is an error here, before any loop over it.
    pub(crate) fn count(&mut self, min_entry_len: usize, field: &'static str) -> Decoded<usize> {
        let offset = self.offset;
        let count = self.length(field)?;
        self.check_count(count, min_entry_len, field, offset)?;
        Ok(count)
    }

    /// An error for a `count`, read at `offset`, whose entries do not fit into the
    /// remaining bytes.
    pub(crate) fn check_count(
        &self,
        count: usize,
        min_entry_len: usize,
        field: &'static str,
        offset: usize,
    ) -> Decoded<()> {
        let needed = count.checked_mul(min_entry_len);
        if needed.is_none_or(|needed| needed > self.rest.len()) {
            return Err(DecodeError::ImplausibleCount {
                field,
                offset,
                count,
                available: self.rest.len(),
            });
        }
        Ok(())
    }

    pub(crate) fn length(&mut self, field: &'static str) -> Decoded<usize> {
        let offset = self.offset;
        let value = self.i32(field)?;
        usize::try_from(value).map_err(|_| DecodeError::NegativeCount {
            field,
            offset,
            value,
        })
    }

    /// Skips `count` entries of `len` bytes.
    pub(crate) fn skip(&mut self, count: usize, len: usize, field: &'static str) -> Decoded<()> {
        self.take(count.saturating_mul(len), field).map(drop)
    }

    /// The bytes whose number is in a leading `i32`.
    pub(crate) fn sized(&mut self, field: &'static str) -> Decoded<Self> {
        let len = self.length(field)?;
        let offset = self.offset;
        Ok(Self::new(self.take(len, field)?, offset))
    }

    /// An error when bytes are left.
    pub(crate) const fn finish(&self, field: &'static str) -> Decoded<()> {
        if self.rest.is_empty() {
            return Ok(());
        }
        Err(DecodeError::TrailingBytes {
            field,
            offset: self.offset,
            count: self.rest.len(),
        })
    }
}

/// What is decoded, or why it can't be.
pub(crate) type Decoded<T> = Result<T, DecodeError>;

/// Why a datagram can't be decoded. Offsets count from the datagram's first byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The datagram or the section ends inside a field.
    #[error("{field} at byte {offset} needs {needed} bytes, only {available} are left")]
    Truncated {
        /// The field being read.
        field: &'static str,
        /// Where the field begins.
        offset: usize,
        /// Bytes the field takes.
        needed: usize,
        /// Bytes left.
        available: usize,
    },
    /// The header's payload length differs from the datagram's.
    #[error("the header declares {declared} payload bytes, the datagram holds {actual}")]
    LengthMismatch {
        /// Length in the header.
        declared: usize,
        /// Bytes after the header.
        actual: usize,
    },
    /// No NUL before the end.
    #[error("{field} at byte {offset} has no terminating NUL")]
    UnterminatedString {
        /// The string being read.
        field: &'static str,
        /// Where the string begins.
        offset: usize,
    },
    /// A name or text that is not UTF-8.
    #[error("{field} at byte {offset} is not UTF-8")]
    InvalidUtf8 {
        /// The string being read.
        field: &'static str,
        /// Where the string begins.
        offset: usize,
    },
    /// A negative count or size.
    #[error("{field} at byte {offset} is {value}, which is negative")]
    NegativeCount {
        /// The count being read.
        field: &'static str,
        /// Where the count is.
        offset: usize,
        /// Its value.
        value: i32,
    },
    /// More entries than the bytes left can hold.
    #[error("{field} at byte {offset} is {count}, more than the {available} bytes left can hold")]
    ImplausibleCount {
        /// The count being read.
        field: &'static str,
        /// Where the count is.
        offset: usize,
        /// Its value.
        count: usize,
        /// Bytes left after it.
        available: usize,
    },
    /// Bytes remain where the packet or a sized section should end.
    #[error("{count} bytes at byte {offset} are left over after {field}")]
    TrailingBytes {
        /// The part that was read completely.
        field: &'static str,
        /// Where the surplus begins.
        offset: usize,
        /// How many bytes are left over.
        count: usize,
    },
    /// The frame's last word is not zero: the frame has the layout of another version.
    #[error("the end tag at byte {offset} is {value} instead of 0: wrong bitstream version?")]
    EndTag {
        /// Where the tag is.
        offset: usize,
        /// Its value.
        value: i32,
    },
    /// A dataset of unknown type in a version that gives no sizes to skip by.
    #[error("dataset type {type_id} at byte {offset} is unknown and {version} gives no size")]
    UnknownDataset {
        /// Where the dataset begins.
        offset: usize,
        /// Its type.
        type_id: i32,
        /// The version decoded with.
        version: BitstreamVersion,
    },
    /// A length that the message never has.
    #[error("{message} has a payload of {actual} bytes, which no version sends")]
    UnexpectedLength {
        /// The message.
        message: &'static str,
        /// Its payload's length.
        actual: usize,
    },
    /// An unknown message, or one of the other direction.
    #[error("message id {id} is not expected from this side")]
    UnexpectedMessage {
        /// The id in the header.
        id: u16,
    },
}
