//! Messages over a pipe: four bytes of length, little-endian, then postcard.

use std::io::{self, Read, Write};

use serde::{Serialize, de::DeserializeOwned};

/// Largest length of a message.
const MAX_LENGTH: u32 = 1 << 24;

/// Errors of sending and receiving.
#[derive(Debug, thiserror::Error)]
pub enum PipeError {
    /// Error of the pipe, for example after the other side has ended.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The length exceeds the limit.
    #[error("message too long: {0} bytes")]
    Length(u32),
    /// The bytes do not decode.
    #[error("invalid message: {0}")]
    Codec(#[from] postcard::Error),
}

/// Sends a message and flushes the pipe.
///
/// # Errors
///
/// Fails if the pipe does not accept it.
pub fn send(pipe: &mut impl Write, message: &impl Serialize) -> Result<(), PipeError> {
    let mut bytes = vec![0; 4];
    bytes = postcard::to_extend(message, bytes)?;
    let length = u32::try_from(bytes.len() - 4).unwrap_or(u32::MAX);
    if length > MAX_LENGTH {
        return Err(PipeError::Length(length));
    }
    if let Some(prefix) = bytes.get_mut(..4) {
        prefix.copy_from_slice(&length.to_le_bytes());
    }
    pipe.write_all(&bytes)?;
    Ok(pipe.flush()?)
}

/// Receives a message; `None` if the other side has closed the pipe.
///
/// # Errors
///
/// Fails if the message is truncated, too long or invalid.
pub fn receive<T: DeserializeOwned>(pipe: &mut impl Read) -> Result<Option<T>, PipeError> {
    let mut prefix = [0; 4];
    let mut filled = 0;
    while let Some(rest @ [_, ..]) = prefix.get_mut(filled..) {
        match pipe.read(rest) {
            Ok(0) if filled == 0 => return Ok(None),
            Ok(0) => return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into()),
            Ok(count) => filled += count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error.into()),
        }
    }
    let length = u32::from_le_bytes(prefix);
    if length > MAX_LENGTH {
        return Err(PipeError::Length(length));
    }
    let mut bytes = vec![0; length as usize];
    pipe.read_exact(&mut bytes)?;
    Ok(Some(postcard::from_bytes(&bytes)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Request, ResetFlags, Run};

    #[test]
    fn messages_pass_in_order_until_the_end() {
        let messages = [
            Request::Start(ResetFlags::POWER_ON),
            Request::Run(Run {
                until: u64::MAX,
                received: vec![(7, 255)],
                ..Run::default()
            }),
            Request::Measure,
        ];
        let mut pipe = Vec::new();
        for message in &messages {
            send(&mut pipe, message).unwrap();
        }
        let mut pipe = pipe.as_slice();
        for message in messages {
            assert_eq!(receive(&mut pipe).unwrap(), Some(message));
        }
        assert_eq!(receive::<Request>(&mut pipe).unwrap(), None);
    }

    #[test]
    fn a_truncated_overlong_or_invalid_message_is_an_error() {
        let mut whole = Vec::new();
        send(&mut whole, &Request::Start(ResetFlags::EXTERNAL)).unwrap();
        for length in 1..whole.len() {
            assert!(receive::<Request>(&mut &whole[..length]).is_err());
        }
        let too_long = u32::MAX.to_le_bytes();
        assert!(matches!(
            receive::<Request>(&mut too_long.as_slice()),
            Err(PipeError::Length(_))
        ));
        assert!(matches!(
            receive::<Request>(&mut [1, 0, 0, 0, 99].as_slice()),
            Err(PipeError::Codec(_))
        ));
    }
}
