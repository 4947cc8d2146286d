//! Frames: a packet made safe for a line that loses and damages bytes.
//!
//! ```text
//! COBS( type: u8 | payload | CRC-16/X-25: u16 LE ) 00
//! ```
//!
//! No byte of a frame but its last is zero, so a receiver that has lost its
//! place finds it again at the next zero. A sender puts one zero on the line
//! after connecting: it ends whatever the receiver had begun to hear.

use crate::codec::{Field, Writer};
use crate::crc::Crc16;

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
#[derive(Clone, Debug)]
pub struct Frame {
    bytes: [u8; MAX_FRAME_LENGTH],
    length: u8,
}

impl Frame {
    /// The bytes to send.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes
            .get(..usize::from(self.length))
            .unwrap_or_default()
    }

    /// No frame yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            bytes: [0; MAX_FRAME_LENGTH],
            length: 0,
        }
    }

    /// Puts type byte and payload in an envelope.
    ///
    /// A payload that is too long is cut, and every receiver refuses it by its
    /// length; the tests show that none is.
    pub(crate) fn build(&mut self, kind: u8, payload: &impl Field) {
        let mut writer = self.open(kind);
        payload.write(&mut writer);
        let room = writer.room();
        self.seal(MAX_PAYLOAD_LENGTH - room);
    }

    /// A frame whose payload `fill` writes to a buffer of [`MAX_PAYLOAD_LENGTH`]
    /// bytes; it returns the length.
    pub(crate) fn filled(kind: u8, fill: impl FnOnce(&mut [u8]) -> usize) -> Self {
        let mut frame = Self::new();
        let [_, first, rest @ ..] = &mut frame.bytes;
        *first = kind;
        let length = fill(rest.get_mut(..MAX_PAYLOAD_LENGTH).unwrap_or_default());
        frame.seal(length);
        frame
    }

    /// Begins a packet.
    #[inline(never)]
    fn open(&mut self, kind: u8) -> Writer<'_> {
        let [count, first, rest @ ..] = &mut self.bytes;
        *count = 0;
        *first = kind;
        Writer::new(rest.get_mut(..MAX_PAYLOAD_LENGTH).unwrap_or_default())
    }

    /// Adds check sum and COBS to type byte and payload, which begin at the second byte.
    #[inline(never)]
    fn seal(&mut self, payload_length: usize) {
        // In range, but the compiler could not know.
        let crc_at = 2 + payload_length.min(MAX_PAYLOAD_LENGTH);
        let mut crc = Crc16::new();
        for &byte in self.bytes.get(1..crc_at).unwrap_or_default() {
            crc.update(byte);
        }
        if let Some([low, high, end, ..]) = self.bytes.get_mut(crc_at..) {
            [*low, *high] = crc.finish();
            *end = 0;
        }
        // The zero that ends the frame stays; each one before it (the first byte
        // is one) becomes the distance to the next.
        let end = crc_at + 2;
        let mut distance = 1;
        for byte in self
            .bytes
            .get_mut(..end)
            .unwrap_or_default()
            .iter_mut()
            .rev()
        {
            if *byte == 0 {
                *byte = distance;
                distance = 0;
            }
            distance += 1;
        }
        self.length = end as u8 + 1;
    }
}

impl PartialEq for Frame {
    fn eq(&self, other: &Self) -> bool {
        self.as_bytes() == other.as_bytes()
    }
}

impl Eq for Frame {}

impl Default for Frame {
    fn default() -> Self {
        Self::new()
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
    packet: [u8; MAX_PACKET_LENGTH],
    length: u8,
    too_long: bool,
    crc: Crc16,
    in_frame: bool,
    /// COBS: bytes to come until the next that counts others,
    until_count: u8,
    /// which stands for a zero unless the one before it was [`FULL_BLOCK`].
    full_block: bool,
}

/// The number that says of a block of COBS that no zero follows it.
const FULL_BLOCK: u8 = 0xFF;

impl Decoder {
    /// A decoder that expects the first byte of a frame.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            packet: [0; MAX_PACKET_LENGTH],
            length: 0,
            too_long: false,
            crc: Crc16::new(),
            in_frame: false,
            until_count: 0,
            full_block: false,
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
        if self.push_data(byte) || !self.in_frame {
            return None;
        }
        self.in_frame = false;
        Some(self.finish())
    }

    /// Takes a byte that is not zero: none of those ends a frame. Returns `false`,
    /// and does nothing, when it is zero.
    #[inline(always)]
    pub fn push_data(&mut self, byte: u8) -> bool {
        if byte != 0 {
            self.unstuff(byte);
        }
        byte != 0
    }

    /// A byte that is not zero.
    #[inline(never)]
    fn unstuff(&mut self, byte: u8) {
        if self.in_frame {
            if self.until_count != 0 {
                self.until_count -= 1;
                self.append(byte);
                return;
            }
            if !self.full_block {
                self.append(0);
            }
        } else {
            self.in_frame = true;
            self.length = 0;
            self.too_long = false;
            self.crc = Crc16::new();
        }
        self.until_count = byte - 1;
        self.full_block = byte == FULL_BLOCK;
    }

    #[inline(always)]
    fn append(&mut self, byte: u8) {
        self.crc.update(byte);
        match self.packet.get_mut(usize::from(self.length)) {
            Some(slot) => {
                *slot = byte;
                self.length += 1;
            }
            None => self.too_long = true,
        }
    }

    fn finish(&self) -> Result<Packet<'_>, FrameError> {
        if self.too_long {
            return Err(FrameError::TooLong);
        }
        if self.until_count != 0 {
            return Err(FrameError::Truncated);
        }
        let Some(payload_length) = usize::from(self.length).checked_sub(ENVELOPE_LENGTH) else {
            return Err(FrameError::TooShort(self.length));
        };
        let [kind, rest @ ..] = &self.packet;
        match rest.get(..payload_length) {
            Some(payload) if self.crc.is_residue() => Ok(Packet {
                kind: *kind,
                payload,
            }),
            _ => Err(FrameError::CheckSum),
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
    use super::{Decoder, Frame, FrameError, MAX_FRAME_LENGTH, MAX_PAYLOAD_LENGTH, Packet};
    use crate::codec::{Field, Reader, Writer};
    use proptest::{collection::vec, prelude::*};
    use std::vec::Vec;

    struct Raw<'a>(&'a [u8]);

    impl Field for Raw<'_> {
        fn write(&self, writer: &mut Writer<'_>) {
            self.0.iter().for_each(|byte| byte.write(writer));
        }

        fn read(_: &mut Reader<'_>) -> Self {
            Raw(&[])
        }
    }

    fn frame(kind: u8, payload: &[u8]) -> Frame {
        let mut frame = Frame::new();
        frame.build(kind, &Raw(payload));
        frame
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

    fn check_sum(bytes: &[u8]) -> [u8; 2] {
        let crc = crc::Crc::<u16>::new(&crc::CRC_16_IBM_SDLC);
        crc.checksum(bytes).to_le_bytes()
    }

    /// The same by independent implementations.
    fn reference(kind: u8, payload: &[u8]) -> Vec<u8> {
        let message = [&[kind], payload].concat();
        let packet = [&message[..], &check_sum(&message)].concat();
        [cobs::encode_vec(&packet), Vec::from([0])].concat()
    }

    /// Likewise: what each byte of a stream yields, good packets as their bytes.
    fn reference_outcomes(stream: &[u8]) -> Vec<Option<Result<Vec<u8>, FrameError>>> {
        use cobs::{DecodeResult, DecoderState};

        let mut state = DecoderState::Idle;
        let mut packet = Vec::new();
        let outcome = |packet: &[u8], complete: bool| {
            if packet.len() > super::MAX_PACKET_LENGTH {
                return Err(FrameError::TooLong);
            }
            if !complete {
                return Err(FrameError::Truncated);
            }
            match packet.split_last_chunk::<2>() {
                Some((message @ [_, ..], crc)) if *crc == check_sum(message) => Ok(message.into()),
                Some(([_, ..], _)) => Err(FrameError::CheckSum),
                _ => Err(FrameError::TooShort(packet.len() as u8)),
            }
        };
        let mut outcomes = Vec::new();
        for &byte in stream {
            outcomes.push(match state.feed(byte) {
                Ok(DecodeResult::DataStart) => {
                    packet.clear();
                    None
                }
                Ok(DecodeResult::NoData) => None,
                Ok(DecodeResult::DataContinue(data)) => {
                    packet.push(data);
                    None
                }
                Ok(DecodeResult::DataComplete) => Some(outcome(&packet, true)),
                Err(_) => {
                    state = DecoderState::Idle;
                    Some(outcome(&packet, false))
                }
            });
        }
        outcomes
    }

    proptest! {
        #[test]
        fn frames_are_those_of_an_independent_implementation(
            kind: u8,
            payload in vec(prop_oneof![Just(0), any::<u8>()], 0..=MAX_PAYLOAD_LENGTH),
        ) {
            let frame = frame(kind, &payload);
            prop_assert_eq!(frame.as_bytes(), &reference(kind, &payload)[..]);
        }

        #[test]
        fn any_stream_yields_what_it_yields_to_an_independent_implementation(
            stream in vec(
                prop_oneof![
                    3 => vec(prop_oneof![Just(0), Just(1), Just(2), Just(255), any::<u8>()], 0..20),
                    3 => vec(prop_oneof![Just(0), any::<u8>()], 0..=MAX_PAYLOAD_LENGTH)
                        .prop_map(|payload| reference(9, &payload)),
                    1 => vec(1_u8.., 240..270),
                ],
                0..8,
            ),
        ) {
            let stream = stream.concat();
            let mut decoder = Decoder::new();
            let outcomes: Vec<_> = stream
                .iter()
                .map(|&byte| {
                    Some(decoder.push(byte)?.map(|packet| {
                        [&[packet.kind], packet.payload].concat()
                    }))
                })
                .collect();
            prop_assert_eq!(outcomes, reference_outcomes(&stream));
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
