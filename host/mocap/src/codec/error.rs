//! Why a datagram can't be decoded.

use super::version::BitstreamVersion;

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
