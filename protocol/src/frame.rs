//! Frames: a packet made safe for a line that loses and damages bytes.
//!
//! ```text
//! COBS( type: u8 | payload | CRC-16/X-25: u16 LE ) 00
//! ```
//!
//! No byte of a frame but its last is zero, so a receiver that has lost its
//! place finds it again at the next zero. A sender puts one zero on the line
//! after connecting: it ends whatever the receiver had begun to hear.

use cobs::{DecodeResult, DecoderState};

use crate::crc::{Crc16, crc16};

/// Length of the longest payload, in bytes: [`crate::Configure`].
pub const MAX_PAYLOAD_LENGTH: usize = 41;

/// Length of type byte and check sum, in bytes.
const ENVELOPE_LENGTH: usize = 3;

/// Length of the longest packet before COBS, in bytes.
const MAX_PACKET_LENGTH: usize = MAX_PAYLOAD_LENGTH + ENVELOPE_LENGTH;

/// Length of the longest frame, in bytes, with the zero that ends it.
pub const MAX_FRAME_LENGTH: usize = frame_length(MAX_PAYLOAD_LENGTH);

// Up to 253 bytes COBS costs exactly one byte, whatever the contents: a frame
// then has the same length every time, and the load of the line is known.
const _: () = assert!(MAX_PACKET_LENGTH < 254);

/// Length of a frame on the wire with a payload of `payload_length` bytes:
/// type, check sum, one byte of COBS, and the zero that ends it.
#[must_use]
pub const fn frame_length(payload_length: usize) -> usize {
    payload_length + ENVELOPE_LENGTH + 2
}

/// One frame, ready for the line, with the zero that ends it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame(heapless::Vec<u8, MAX_FRAME_LENGTH>);

impl Frame {
    /// The bytes to send.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// Puts type byte and payload in an envelope. `write` fills in the payload
    /// and returns its length.
    ///
    /// A payload that `write` cannot produce is sent empty, which every
    /// receiver refuses by its length; the tests show that none is.
    pub(crate) fn build(kind: u8, write: impl FnOnce(&mut [u8]) -> Option<usize>) -> Self {
        let mut packet: heapless::Vec<u8, MAX_PACKET_LENGTH> = heapless::Vec::new();
        // `resize` and `extend_from_slice` fail beyond the capacity only.
        let _ = packet.resize_default(1 + MAX_PAYLOAD_LENGTH);
        let mut length = 0;
        if let Some((first, payload)) = packet.split_first_mut() {
            *first = kind;
            length = write(payload).unwrap_or(0);
        }
        packet.truncate(1 + length);
        let crc = crc16(&packet).to_le_bytes();
        let _ = packet.extend_from_slice(&crc);

        let mut frame = heapless::Vec::new();
        let _ = frame.resize_default(MAX_FRAME_LENGTH);
        let stuffed = cobs::try_encode(&packet, &mut frame).unwrap_or(0);
        frame.truncate(stuffed);
        let _ = frame.push(0);
        Self(frame)
    }
}

impl AsRef<[u8]> for Frame {
    fn as_ref(&self) -> &[u8] {
        self.as_bytes()
    }
}

/// What a good frame held: its check sum was right, its meaning is not yet known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// The type byte; see [`crate::MessageType`].
    pub kind: u8,
    /// The bytes between type and check sum.
    pub payload: &'a [u8],
}

/// Why the bytes between two zeros are not a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The line lost bytes, or damaged one of those that count others.
    #[error("the frame ended in the middle: bytes were lost or damaged")]
    Truncated,
    /// Longer than any frame of this version.
    #[error(
        "more than {MAX_FRAME_LENGTH} bytes without a zero: the frame is too long, or its end was lost"
    )]
    TooLong,
    /// Not even a type byte and a check sum.
    #[error("the frame holds {0} bytes, fewer than a type byte and a check sum")]
    TooShort(u8),
    /// A byte was damaged.
    #[error("the check sum is wrong: a byte was damaged")]
    CheckSum,
}

/// Finds frames in a stream of bytes.
///
/// Give it every byte received with [`Decoder::push`], in order. It keeps
/// nothing but the frame it is in, needs the same time for every byte, and
/// finds its place again at the next zero whatever came before.
#[derive(Debug)]
pub struct Decoder {
    packet: heapless::Vec<u8, MAX_PACKET_LENGTH>,
    stuffing: DecoderState,
    crc: Crc16,
    too_long: bool,
}

impl Decoder {
    /// A decoder that expects the first byte of a frame.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            packet: heapless::Vec::new(),
            stuffing: DecoderState::Idle,
            crc: Crc16::new(),
            too_long: false,
        }
    }

    /// Takes one byte; at the end of a frame, returns what it held.
    ///
    /// Zeros between frames are silent.
    ///
    /// # Errors
    ///
    /// One [`FrameError`] for every stretch between two zeros that is no frame.
    pub fn push(&mut self, byte: u8) -> Option<Result<Packet<'_>, FrameError>> {
        if matches!(self.stuffing, DecoderState::Idle) {
            if byte == 0 {
                return None;
            }
            self.packet.clear();
            self.crc = Crc16::new();
            self.too_long = false;
        }
        match self.stuffing.feed(byte) {
            Ok(DecodeResult::DataContinue(data)) => {
                self.crc.update(data);
                self.too_long |= self.packet.push(data).is_err();
                None
            }
            Ok(DecodeResult::NoData | DecodeResult::DataStart) => None,
            Ok(DecodeResult::DataComplete) => Some(self.finish()),
            Err(_) => {
                self.stuffing = DecoderState::Idle;
                Some(Err(self.error_or_too_long(FrameError::Truncated)))
            }
        }
    }

    fn finish(&self) -> Result<Packet<'_>, FrameError> {
        if self.too_long {
            return Err(FrameError::TooLong);
        }
        let length = self.packet.len();
        let (Some((&kind, rest)), Some(payload_length)) = (
            self.packet.split_first(),
            length.checked_sub(ENVELOPE_LENGTH),
        ) else {
            return Err(FrameError::TooShort(length as u8));
        };
        match rest.get(..payload_length) {
            Some(payload) if self.crc.is_residue() => Ok(Packet { kind, payload }),
            _ => Err(FrameError::CheckSum),
        }
    }

    const fn error_or_too_long(&self, error: FrameError) -> FrameError {
        if self.too_long {
            FrameError::TooLong
        } else {
            error
        }
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::{Decoder, Frame, FrameError, MAX_FRAME_LENGTH, Packet};

    fn frame(kind: u8, payload: &[u8]) -> Frame {
        Frame::build(kind, |buffer| {
            buffer[..payload.len()].copy_from_slice(payload);
            Some(payload.len())
        })
    }

    /// The outcome of the last byte; no earlier byte may have one.
    fn outcome<'a>(
        decoder: &'a mut Decoder,
        bytes: &[u8],
    ) -> Option<Result<Packet<'a>, FrameError>> {
        let (&last, head) = bytes.split_last().unwrap();
        for &byte in head {
            assert_eq!(decoder.push(byte), None);
        }
        decoder.push(last)
    }

    #[test]
    fn a_frame_gives_its_packet_at_its_last_byte() {
        let mut decoder = Decoder::new();
        let bytes = frame(7, &[0, 1, 0, 0, 2]);
        let packet = Packet {
            kind: 7,
            payload: &[0, 1, 0, 0, 2],
        };
        assert_eq!(outcome(&mut decoder, bytes.as_bytes()), Some(Ok(packet)));
    }

    #[test]
    fn zeros_between_frames_are_silent() {
        let mut decoder = Decoder::new();
        for _ in 0..3 {
            assert_eq!(decoder.push(0), None);
        }
        assert!(matches!(
            outcome(&mut decoder, frame(1, &[]).as_bytes()),
            Some(Ok(_))
        ));
        assert_eq!(decoder.push(0), None);
    }

    #[test]
    fn every_kind_of_damage_has_its_name() {
        let good = frame(7, &[9; 10]);
        let mut damaged = frame(7, &[9; 10]).as_bytes().to_owned_array();
        damaged[5] ^= 1;
        let cases: [(&[u8], FrameError); 5] = [
            (&[5, 1, 2, 0], FrameError::Truncated),
            (&[1, 0], FrameError::TooShort(0)),
            (&[3, 1, 2, 0], FrameError::TooShort(2)),
            (&damaged[..good.as_bytes().len()], FrameError::CheckSum),
            (&OVERLONG, FrameError::TooLong),
        ];
        let mut decoder = Decoder::new();
        for (bytes, error) in cases {
            assert_eq!(outcome(&mut decoder, bytes), Some(Err(error)));
            assert!(matches!(
                outcome(&mut decoder, good.as_bytes()),
                Some(Ok(_))
            ));
        }
    }

    const OVERLONG: [u8; 301] = {
        let mut bytes = [0x55; 301];
        bytes[300] = 0;
        bytes
    };

    trait ToOwnedArray {
        fn to_owned_array(&self) -> [u8; MAX_FRAME_LENGTH];
    }

    impl ToOwnedArray for [u8] {
        fn to_owned_array(&self) -> [u8; MAX_FRAME_LENGTH] {
            let mut array = [0; MAX_FRAME_LENGTH];
            array[..self.len()].copy_from_slice(self);
            array
        }
    }
}
