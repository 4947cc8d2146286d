//! Framing for a line that loses and corrupts bytes, and its two checksums, in forms that suit an
//! 8-bit processor.
//!
//! ```text
//! COBS( type: u8 | payload | CRC-16/X-25: u16 LE ) 00
//! ```
//!
//! Zero occurs only as the last byte of a frame, so a receiver synchronises at the
//! next zero. After connecting, a sender first transmits one zero, which ends any
//! partial frame at the receiver.
//!
//! On the AVR every constant is in SRAM; the usual table of 256 entries would take
//! a quarter of it. CRC-16/X-25 is therefore computed by nibbles in registers, and
//! CRC-32, which is needed once per configuration, by bits.

use crate::codec::{Field, Writer};

/// Length of the longest payload, in bytes: [`crate::Configure`].
pub const MAX_PAYLOAD_LENGTH: usize = 50;

/// Length of type byte and checksum, in bytes.
const ENVELOPE_LENGTH: usize = 3;

/// Length of the longest packet before COBS, in bytes.
const MAX_PACKET_LENGTH: usize = MAX_PAYLOAD_LENGTH + ENVELOPE_LENGTH;

/// Length of the longest frame, in bytes, including the final zero.
pub const MAX_FRAME_LENGTH: usize = frame_length(MAX_PAYLOAD_LENGTH);

// Up to 253 bytes, COBS adds exactly one byte, so the length of a frame does not
// depend on its contents and the load of the line is known.
const _: () = assert!(MAX_PACKET_LENGTH < 254);

/// Length of a frame on the wire with a payload of `payload_length` bytes: type,
/// checksum, one byte of COBS, and the final zero.
pub const fn frame_length(payload_length: usize) -> usize {
    payload_length + ENVELOPE_LENGTH + 2
}

/// An encoded frame, including the final zero.
#[derive(Clone, Debug)]
pub struct Frame {
    bytes: [u8; MAX_FRAME_LENGTH],
    length: u8,
}

impl Frame {
    /// The bytes to send.
    pub fn as_bytes(&self) -> &[u8] {
        let length = usize::from(self.length);
        self.bytes.get(..length).unwrap_or_default()
    }

    /// An empty frame.
    pub const fn new() -> Self {
        Self {
            bytes: [0; MAX_FRAME_LENGTH],
            length: 0,
        }
    }

    /// Encodes type byte and payload.
    ///
    /// A payload that is too long is truncated, and every receiver refuses it by
    /// its length; tests show that no message is.
    pub(crate) fn build(&mut self, kind: u8, payload: &impl Field) {
        let mut writer = self.open(kind);
        payload.write(&mut writer);
        let room = writer.room();
        self.seal(MAX_PAYLOAD_LENGTH - room);
    }

    /// A frame whose payload is written by `fill` to a buffer of
    /// [`MAX_PAYLOAD_LENGTH`] bytes; `fill` returns the length.
    pub(crate) fn filled(kind: u8, fill: impl FnOnce(&mut [u8]) -> usize) -> Self {
        let mut frame = Self::new();
        let [_, first, rest @ ..] = &mut frame.bytes;
        *first = kind;
        let length = fill(rest.get_mut(..MAX_PAYLOAD_LENGTH).unwrap_or_default());
        frame.seal(length);
        frame
    }

    /// Starts a packet.
    #[inline(never)]
    fn open(&mut self, kind: u8) -> Writer<'_> {
        let [count, first, rest @ ..] = &mut self.bytes;
        *count = 0;
        *first = kind;
        Writer::new(rest.get_mut(..MAX_PAYLOAD_LENGTH).unwrap_or_default())
    }

    /// Adds checksum and COBS to type byte and payload, which start at the second byte.
    #[inline(never)]
    fn seal(&mut self, payload_length: usize) {
        // Always in range; the compiler can't prove it.
        let crc_at = 2 + payload_length.min(MAX_PAYLOAD_LENGTH);
        let mut crc = Crc16::new();
        for &byte in self.bytes.get(1..crc_at).unwrap_or_default() {
            crc.update(byte);
        }
        if let Some([low, high, end, ..]) = self.bytes.get_mut(crc_at..) {
            [*low, *high] = crc.finish();
            *end = 0;
        }
        // The final zero stays; every zero before it becomes the distance to the
        // next. The first byte counts as a zero.
        let end = crc_at + 2;
        let mut distance = 1;
        let stuffed = self.bytes.get_mut(..end).unwrap_or_default();
        for byte in stuffed.iter_mut().rev() {
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

/// Contents of a frame with a valid checksum, not yet decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet<'a> {
    /// The type byte; see [`crate::MessageType`].
    pub kind: u8,
    /// The bytes between type and checksum.
    pub payload: &'a [u8],
}

/// Errors in the bytes between two zeros.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// Bytes were lost, or a COBS code byte was corrupted.
    #[error("frame truncated: bytes were lost or corrupted")]
    Truncated,
    /// Longer than any frame of this version.
    #[error(
        "more than {MAX_FRAME_LENGTH} bytes without a zero: the frame is too long or its end was lost"
    )]
    TooLong,
    /// Shorter than a type byte and a checksum.
    #[error("the frame has {0} bytes, fewer than a type byte and a checksum")]
    TooShort(u8),
    /// The checksum does not match: a byte was corrupted.
    #[error("wrong checksum: a byte was corrupted")]
    CheckSum,
}

/// Finds frames in a stream of bytes.
///
/// Pass every received byte to [`Decoder::push`], in order. It stores only the
/// current frame, takes the same time for every byte, and synchronises at the next
/// zero after any input.
#[derive(Clone, Debug)]
pub struct Decoder {
    packet: [u8; MAX_PACKET_LENGTH],
    length: u8,
    too_long: bool,
    crc: Crc16,
    in_frame: bool,
    /// COBS: bytes left until the next code byte.
    until_count: u8,
    /// The last code byte was [`FULL_BLOCK`], so the next one stands for no zero.
    full_block: bool,
}

/// COBS code byte of a block that is not followed by a zero.
const FULL_BLOCK: u8 = 0xFF;

impl Decoder {
    /// A decoder at the start of a frame.
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

    /// Processes one byte; returns the packet at the end of a frame.
    ///
    /// Further zeros between frames are ignored.
    ///
    /// # Errors
    ///
    /// One [`FrameError`] for every invalid sequence between two zeros.
    pub fn push(&mut self, byte: u8) -> Option<Result<Packet<'_>, FrameError>> {
        if self.push_data(byte) || !self.in_frame {
            return None;
        }
        self.in_frame = false;
        Some(self.finish())
    }

    /// Processes a byte other than zero, which never ends a frame. Returns `false`,
    /// without effect, if the byte is zero.
    #[inline(always)]
    pub fn push_data(&mut self, byte: u8) -> bool {
        if byte != 0 {
            self.unstuff(byte);
        }
        byte != 0
    }

    /// Undoes COBS for one byte, which is not zero.
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
        let [kind, ref rest @ ..] = self.packet;
        match rest.get(..payload_length) {
            Some(payload) if self.crc.is_residue() => Ok(Packet { kind, payload }),
            _ => Err(FrameError::CheckSum),
        }
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

/// Running CRC-16/X-25.
///
/// Two bytes instead of a 16-bit number, because the board computes in bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Crc16 {
    low: u8,
    high: u8,
}

impl Crc16 {
    /// State after a message and its checksum: 0xF0B8, low byte first.
    const RESIDUE: [u8; 2] = [0xB8, 0xF0];

    pub(crate) const fn new() -> Self {
        Self {
            low: 0xFF,
            high: 0xFF,
        }
    }

    #[inline(always)]
    const fn update(&mut self, byte: u8) {
        // Reflected polynomial 0x8408. Its two nibble steps reduce to shifts
        // because it is sparse: x^16 + x^12 + x^5 + 1.
        let mut mixed = byte ^ self.low;
        mixed ^= mixed << 4;
        self.low = self.high ^ (mixed >> 4) ^ (mixed << 3);
        self.high = mixed ^ (mixed >> 5);
    }

    /// The checksum in the order of transmission, low byte first.
    pub(crate) const fn finish(self) -> [u8; 2] {
        [!self.low, !self.high]
    }

    /// Whether the last two bytes were the checksum of all bytes before them.
    const fn is_residue(self) -> bool {
        self.low == Self::RESIDUE[0] && self.high == Self::RESIDUE[1]
    }
}

/// CRC-32/ISO-HDLC of `bytes`, as in Ethernet and zip.
pub(crate) fn crc32(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for &byte in bytes {
        crc ^= u32::from(byte);
        for _ in 0..8 {
            crc = if crc & 1 == 0 {
                crc >> 1
            } else {
                (crc >> 1) ^ 0xEDB8_8320
            };
        }
    }
    !crc
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use proptest::{collection::vec, prelude::*};

    use super::{
        Crc16, Decoder, Frame, FrameError, MAX_FRAME_LENGTH, MAX_PAYLOAD_LENGTH, Packet, crc32,
    };
    use crate::codec::{Field, Reader, Writer};

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

    /// The outcome of the last byte; asserts that no earlier byte has one.
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
    fn a_frame_yields_its_packet_at_its_last_byte() {
        let mut decoder = Decoder::new();
        let bytes = frame(7, &[0, 1, 0, 0, 2]);
        let packet = Packet {
            kind: 7,
            payload: &[0, 1, 0, 0, 2],
        };
        assert_eq!(outcome(&mut decoder, bytes.as_bytes()), Some(Ok(packet)));
    }

    #[test]
    fn zeros_between_frames_are_ignored() {
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
    fn every_kind_of_corruption_has_its_error() {
        let good = frame(7, &[9; 10]);
        let mut corrupted = frame(7, &[9; 10]).as_bytes().to_owned_array();
        corrupted[5] ^= 1;
        let cases: [(&[u8], FrameError); 5] = [
            (&[5, 1, 2, 0], FrameError::Truncated),
            (&[1, 0], FrameError::TooShort(0)),
            (&[3, 1, 2, 0], FrameError::TooShort(2)),
            (&corrupted[..good.as_bytes().len()], FrameError::CheckSum),
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

    /// The frame by independent implementations.
    fn reference(kind: u8, payload: &[u8]) -> Vec<u8> {
        let message = [&[kind], payload].concat();
        let packet = [&message[..], &check_sum(&message)].concat();
        [cobs::encode_vec(&packet), Vec::from([0])].concat()
    }

    /// The outcome of each byte of a stream, with valid packets as bytes.
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
        fn frames_match_an_independent_implementation(
            kind: u8,
            payload in vec(prop_oneof![Just(0), any::<u8>()], 0..=MAX_PAYLOAD_LENGTH),
        ) {
            let frame = frame(kind, &payload);
            prop_assert_eq!(frame.as_bytes(), &reference(kind, &payload)[..]);
        }

        #[test]
        fn any_stream_gives_the_outcomes_of_an_independent_implementation(
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

    fn crc16(bytes: &[u8]) -> u16 {
        let mut crc = Crc16::new();
        for &byte in bytes {
            crc.update(byte);
        }
        u16::from_le_bytes(crc.finish())
    }

    #[test]
    fn check_values_match_the_catalogue() {
        assert_eq!(crc16(b"123456789"), 0x906E);
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }

    proptest! {
        #[test]
        fn both_agree_with_an_independent_implementation(bytes: [u8; 41], length in 0_usize..=41) {
            let bytes = &bytes[..length];
            prop_assert_eq!(crc16(bytes), crc::Crc::<u16>::new(&crc::CRC_16_IBM_SDLC).checksum(bytes));
            prop_assert_eq!(crc32(bytes), crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(bytes));
        }

        #[test]
        fn a_message_and_its_checksum_leave_the_residue(bytes: [u8; 20], wrong in 1_u16..) {
            for (flip, good) in [(0, true), (wrong, false)] {
                let mut crc = Crc16::new();
                for byte in bytes.into_iter().chain((crc16(&bytes) ^ flip).to_le_bytes()) {
                    crc.update(byte);
                }
                prop_assert_eq!(crc.is_residue(), good);
            }
        }
    }
}
