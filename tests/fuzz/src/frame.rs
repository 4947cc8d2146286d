//! Frames of the serial line with arbitrary packets.

use crc::{CRC_16_IBM_SDLC, Crc};

const CHECKSUM: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_SDLC);

/// A frame with a valid checksum, for any type byte and payload.
///
/// The payload may exceed those of all messages, up to 255 bytes.
pub(crate) fn frame(kind: u8, payload: &[u8]) -> Vec<u8> {
    let mut packet = vec![kind];
    packet.extend_from_slice(payload);
    let checksum = CHECKSUM.checksum(&packet);
    packet.extend_from_slice(&checksum.to_le_bytes());
    let mut frame = vec![0; cobs::max_encoding_length(packet.len()) + 1];
    let length = cobs::encode(&packet, &mut frame);
    // The final zero is already there.
    frame.truncate(length + 1);
    frame
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::{Decoder, Disarm, Message, Packet, Sequence};

    #[test]
    fn frames_match_the_protocol() {
        let disarm = Disarm {
            request: Sequence(7),
        };
        assert_eq!(super::frame(0x12, &[7]), disarm.encode().as_bytes());
        let mut decoder = Decoder::new();
        let packets: Vec<_> = super::frame(0xEE, &[0, 1, 0])
            .into_iter()
            .filter_map(|byte| {
                let Packet { kind, payload } = decoder.push(byte)?.unwrap();
                Some((kind, payload.to_vec()))
            })
            .collect();
        assert_eq!(packets, [(0xEE, vec![0, 1, 0])]);
    }
}
