//! Why a message can't be encoded.

use crate::codec::BitstreamVersion;

/// Why a message can't be encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The buffer ends before the message does.
    #[error("{field} does not fit into the {capacity} bytes of the buffer")]
    BufferTooSmall {
        /// The field that did not fit.
        field: &'static str,
        /// Length of the buffer.
        capacity: usize,
    },
    /// The message is longer than a datagram can be.
    #[error("the message is {len} bytes long, a datagram carries {max}")]
    TooLong {
        /// Length of the message.
        len: usize,
        /// The limit.
        max: usize,
    },
    /// A count or size beyond the range of the wire's `i32`.
    #[error("{field} is {value}, more than the wire can carry")]
    CountOutOfRange {
        /// The count.
        field: &'static str,
        /// Its value.
        value: usize,
    },
    /// A NUL inside a string: it would end the string on the wire.
    #[error("{field} contains a NUL")]
    InteriorNul {
        /// The string.
        field: &'static str,
    },
    /// A name longer than its fixed field.
    #[error("{field} is {len} bytes long, at most {max} fit")]
    NameTooLong {
        /// The name.
        field: &'static str,
        /// Its length.
        len: usize,
        /// The limit.
        max: usize,
    },
    /// A response text that would be read as a status.
    #[error("a response text of three bytes would be read as a status")]
    AmbiguousResponse,
    /// A field that the bitstream version does not have.
    #[error("bitstream {version} has no {field}")]
    NotInVersion {
        /// The field.
        field: &'static str,
        /// The version of the message.
        version: BitstreamVersion,
    },
}
