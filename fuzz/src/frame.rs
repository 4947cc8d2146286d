//! Frames of the serial line around any packet.

use crc::{CRC_16_IBM_SDLC, Crc};

const CHECK_SUM: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_SDLC);

/// A frame whose check sum is right, whatever type byte and payload are.
///
/// The payload may be longer than any message's, up to 255 bytes.
pub(crate) fn frame(kind: u8, payload: &[u8]) -> Vec<u8> {
    let mut packet = vec![kind];
    packet.extend_from_slice(payload);
    let check_sum = CHECK_SUM.checksum(&packet);
    packet.extend_from_slice(&check_sum.to_le_bytes());
    let mut frame = vec![0; cobs::max_encoding_length(packet.len()) + 1];
    let length = cobs::encode(&packet, &mut frame);
    // The zero that ends it is already there.
    frame.truncate(length + 1);
    frame
}

#[cfg(test)]
mod tests {
    use singletrack_protocol::{Decoder, Disarm, Message, Packet, Sequence};

    #[test]
    fn frames_are_those_of_the_protocol() {
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
