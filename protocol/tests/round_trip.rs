//! Every message decodes to what was encoded.

#![expect(clippy::unwrap_used, reason = "helpers of tests may fail loudly")]

use proptest::prelude::*;
use singletrack_protocol::{Decoder, MAX_FRAME_LENGTH, Packet, ToBoard, ToHost};

use crate::samples::{Either, samples};

/// Messages with random fields: random payloads of the right length, of which the
/// accepted ones are used. Enumerations and Booleans are mutated seldom, because
/// few of their values are valid.
fn any_message() -> impl Strategy<Value = Either> {
    let lengths_and_kinds: Vec<_> = samples()
        .iter()
        .map(|sample| {
            let frame = sample.frame();
            let mut decoder = Decoder::new();
            let (&last, head) = frame.as_bytes().split_last().unwrap();
            for &byte in head {
                decoder.push(byte);
            }
            let packet = decoder.push(last).unwrap().unwrap();
            (*sample, packet.kind, packet.payload.to_vec())
        })
        .collect();
    let payload_noise = proptest::collection::vec((any::<u8>(), 0_u8..4), MAX_FRAME_LENGTH);
    (0..lengths_and_kinds.len(), payload_noise).prop_filter_map(
        "an invalid value",
        move |(which, noise)| {
            let (sample, kind, payload) = &lengths_and_kinds[which];
            let mut payload = payload.clone();
            for (byte, (value, keep)) in payload.iter_mut().zip(noise) {
                if keep != 0 {
                    continue;
                }
                *byte = value;
            }
            sample
                .decode_same_direction(Packet {
                    kind: *kind,
                    payload: &payload,
                })
                .ok()
        },
    )
}

proptest! {
    #[test]
    fn messages_round_trip(message in any_message()) {
        let frame = match message {
            Either::ToBoard(message) => message.encode(),
            Either::ToHost(message) => message.encode(),
        };
        let (&last, head) = frame.as_bytes().split_last().unwrap();
        prop_assert_eq!(last, 0);
        prop_assert!(!head.contains(&0));
        let mut decoder = Decoder::new();
        for &byte in head {
            prop_assert_eq!(decoder.push(byte), None);
        }
        let packet = decoder.push(last).unwrap().unwrap();
        let decoded = match message {
            Either::ToBoard(_) => ToBoard::decode(packet).map(Either::ToBoard),
            Either::ToHost(_) => ToHost::decode(packet).map(Either::ToHost),
        };
        prop_assert_eq!(decoded, Ok(message));
    }
}
