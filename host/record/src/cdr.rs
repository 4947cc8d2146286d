//! Messages as ROS 2 encodes them.

use byteorder::LittleEndian;
use serde::Serialize;

use crate::message::Message;

/// The header of a ROS 2 message: plain CDR, little-endian, no options.
pub(crate) const ENCAPSULATION: [u8; 4] = [0x00, 0x01, 0x00, 0x00];

/// Adds a message with its header to `bytes`.
pub(crate) fn encode(
    message: &impl Serialize,
    bytes: &mut Vec<u8>,
) -> Result<(), cdr_encoding::Error> {
    bytes.extend_from_slice(&ENCAPSULATION);
    cdr_encoding::to_writer::<_, LittleEndian, _>(bytes, message)
}

/// The message that `bytes` encode, exactly.
pub(crate) fn decode<M: Message>(bytes: &[u8]) -> Result<M, String> {
    let Some(content) = bytes.strip_prefix(&ENCAPSULATION) else {
        return Err(format!(
            "a message begins with {:02x?}, not with the header of little-endian CDR",
            bytes.get(..4).unwrap_or(bytes)
        ));
    };
    let (message, length) =
        cdr_encoding::from_bytes::<M, LittleEndian>(content).map_err(|error| error.to_string())?;
    if length != content.len() {
        return Err(format!(
            "a message of {} has {} bytes too many",
            M::NAME,
            content.len().saturating_sub(length)
        ));
    }
    Ok(message)
}
