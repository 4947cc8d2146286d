//! Every message decodes to what was encoded; corrupted frames are refused, and do not affect later
//! frames.

#![expect(clippy::unwrap_used, reason = "helpers of tests may fail loudly")]

use proptest::prelude::*;
use singletrack_protocol::{
    DecodeError, Decoder, Frame, FrameError, MAX_FRAME_LENGTH, Packet, ToBoard, ToHost,
};

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

/// Decodes a packet of either direction.
fn decode(packet: Packet<'_>) -> Option<Either> {
    let to_board = ToBoard::decode(packet).map(Either::ToBoard);
    to_board
        .or_else(|_| ToHost::decode(packet).map(Either::ToHost))
        .ok()
}

/// The messages decoded from `bytes`, and the number of refused frames.
fn receive(decoder: &mut Decoder, bytes: &[u8]) -> (Vec<Either>, usize) {
    let mut accepted = Vec::new();
    let mut refused = 0;
    for &byte in bytes {
        match decoder.push(byte) {
            None => {}
            Some(Ok(packet)) => match decode(packet) {
                Some(message) => accepted.push(message),
                None => refused += 1,
            },
            Some(Err(_)) => refused += 1,
        }
    }
    (accepted, refused)
}

/// `Hello` has the same frame in both directions and is decoded as one to the
/// board.
fn as_decoded(message: Either) -> Either {
    match message {
        Either::ToHost(ToHost::Hello(hello)) => Either::ToBoard(hello.into()),
        other => other,
    }
}

/// Sends a corrupted frame, a zero in case its own was lost, and a valid frame;
/// asserts that only the valid one is accepted.
fn assert_refused(corrupted: &[u8], context: &dyn Fn() -> String) {
    let good = samples().pop().unwrap();
    let mut decoder = Decoder::new();
    let (accepted, _) = receive(&mut decoder, corrupted);
    assert_eq!(accepted, [], "{}", context());
    let (accepted, _) = receive(&mut decoder, &[0]);
    assert_eq!(accepted, [], "{}", context());
    let (accepted, refused) = receive(&mut decoder, good.frame().as_bytes());
    assert_eq!(
        (accepted, refused),
        (vec![good.message], 0),
        "{}",
        context()
    );
}

#[test]
fn every_flip_of_one_bit_is_refused() {
    for sample in samples() {
        let golden = sample.frame().as_bytes().to_vec();
        for bit in 0..golden.len() * 8 {
            let mut corrupted = golden.clone();
            corrupted[bit / 8] ^= 1 << (bit % 8);
            assert_refused(&corrupted, &|| format!("{}, bit {bit}", sample.name));
        }
    }
}

#[test]
fn every_flip_of_two_bits_is_refused() {
    for sample in samples() {
        let golden = sample.frame().as_bytes().to_vec();
        let bits = golden.len() * 8;
        for (first, second) in
            (0..bits).flat_map(|first| (0..first).map(move |second| (first, second)))
        {
            let mut corrupted = golden.clone();
            corrupted[first / 8] ^= 1 << (first % 8);
            corrupted[second / 8] ^= 1 << (second % 8);
            let mut decoder = Decoder::new();
            let (mut accepted, _) = receive(&mut decoder, &corrupted);
            accepted.extend(receive(&mut decoder, &[0]).0);
            assert_eq!(accepted, [], "{}, bits {first} and {second}", sample.name);
        }
    }
}

#[test]
fn a_prefix_of_a_frame_yields_nothing_and_a_zero_after_it_an_error() {
    for sample in samples() {
        let golden = sample.frame();
        let golden = golden.as_bytes();
        for length in 0..golden.len() {
            let mut decoder = Decoder::new();
            assert_eq!(
                receive(&mut decoder, &golden[..length]),
                (vec![], 0),
                "{}",
                sample.name
            );
            if (1..golden.len() - 1).contains(&length) {
                assert!(
                    matches!(decoder.push(0), Some(Err(_))),
                    "{}, {length} bytes",
                    sample.name
                );
            }
        }
    }
}

#[test]
fn a_frame_that_lost_a_byte_anywhere_is_refused() {
    for sample in samples() {
        let golden = sample.frame().as_bytes().to_vec();
        for lost in 0..golden.len() - 1 {
            let mut corrupted = golden.clone();
            corrupted.remove(lost);
            assert_refused(&corrupted, &|| format!("{}, byte {lost} lost", sample.name));
        }
    }
}

#[test]
fn too_many_bytes_are_one_error_and_the_next_frame_is_received() {
    let sample = samples().pop().unwrap();
    let mut bytes = vec![1; 10 * MAX_FRAME_LENGTH];
    bytes.push(0);
    let mut decoder = Decoder::new();
    let (&last, head) = bytes.split_last().unwrap();
    assert_eq!(receive(&mut decoder, head), (vec![], 0));
    assert_eq!(decoder.push(last), Some(Err(FrameError::TooLong)));
    assert_eq!(
        receive(&mut decoder, sample.frame().as_bytes()),
        (vec![sample.message], 0)
    );
}

#[test]
fn a_payload_of_another_length_is_refused() {
    let zeros = [0; 64];
    for sample in samples() {
        let mut decoder = Decoder::new();
        let frame = sample.frame();
        let (&last, head) = frame.as_bytes().split_last().unwrap();
        receive(&mut decoder, head);
        let packet = decoder.push(last).unwrap().unwrap();
        let right = packet.payload.len();
        for wrong in (0..=zeros.len()).filter(|&length| length != right) {
            let payload = &zeros[..wrong];
            let outcome = sample.decode_same_direction(Packet {
                kind: packet.kind,
                payload,
            });
            assert!(
                matches!(outcome, Err(DecodeError::Length { expected, actual, .. })
                    if expected == right && actual == wrong),
                "{}: {outcome:?}",
                sample.name
            );
        }
    }
}

#[test]
fn an_unknown_type_byte_is_refused() {
    for kind in 0..=u8::MAX {
        let packet = Packet { kind, payload: &[] };
        let to_board = ToBoard::decode(packet) == Err(DecodeError::UnknownType(kind));
        let to_host = ToHost::decode(packet) == Err(DecodeError::UnknownType(kind));
        assert_eq!(to_board, !matches!(kind, 0x01 | 0x10..=0x15), "{kind:#04x}");
        assert_eq!(to_host, !matches!(kind, 0x01 | 0x20..=0x24), "{kind:#04x}");
    }
}

#[test]
fn an_invalid_number_is_refused() {
    // Request 4 does not exist; request 0 must not be encoded in two bytes.
    let outcome = |payload| {
        ToHost::decode(Packet {
            kind: 0x22,
            payload,
        })
    };
    assert!(matches!(
        outcome(&[4, 0, 0, 0, 0, 0]),
        Err(DecodeError::Value { .. })
    ));
    assert!(matches!(
        outcome(&[0x80, 0, 0, 0, 0, 0]),
        Err(DecodeError::Value { .. })
    ));
}

#[test]
fn the_greeting_of_another_version_is_decoded() {
    // A greeting of version 0x0203; the layout never changes.
    let payload = &[0x03, 0x02, 9, 8, 7, 0x78, 0x56, 0x34, 0x12];
    let Ok(ToHost::Hello(hello)) = ToHost::decode(Packet {
        kind: 0x01,
        payload,
    }) else {
        panic!("not decoded");
    };
    assert_eq!(hello.protocol_version, 0x0203);
    assert_eq!(hello.software_version, [9, 8, 7]);
    assert_eq!(hello.nonce, 0x1234_5678);
}

/// A sequence of bytes on the line.
#[derive(Clone, Debug)]
enum Piece {
    Garbage(Vec<u8>),
    Good(usize),
    Corrupted { sample: usize, at: usize, with: u8 },
    Cut { sample: usize, length: usize },
}

fn piece() -> impl Strategy<Value = Piece> {
    let sample = 0..samples().len();
    prop_oneof![
        proptest::collection::vec(any::<u8>(), 0..80).prop_map(Piece::Garbage),
        sample.clone().prop_map(Piece::Good),
        (sample.clone(), any::<usize>(), 1..=u8::MAX)
            .prop_map(|(sample, at, with)| Piece::Corrupted { sample, at, with }),
        (sample, any::<usize>()).prop_map(|(sample, length)| Piece::Cut { sample, length }),
    ]
}

fn bytes_of(piece: &Piece) -> Vec<u8> {
    let frame = |sample: usize| -> Frame { samples()[sample].frame() };
    match *piece {
        Piece::Garbage(ref bytes) => bytes.clone(),
        Piece::Good(sample) => frame(sample).as_bytes().to_vec(),
        Piece::Corrupted { sample, at, with } => {
            let mut bytes = frame(sample).as_bytes().to_vec();
            let at = at % bytes.len();
            bytes[at] ^= with;
            bytes
        }
        Piece::Cut { sample, length } => {
            let mut bytes = frame(sample).as_bytes().to_vec();
            bytes.truncate(length % bytes.len());
            bytes
        }
    }
}

proptest! {
    #[test]
    fn after_any_bytes_the_second_of_two_valid_frames_is_received(
        pieces in proptest::collection::vec(piece(), 0..8),
        sample in 0..samples().len(),
    ) {
        let mut decoder = Decoder::new();
        for piece in &pieces {
            receive(&mut decoder, &bytes_of(piece));
        }
        // The first one may be merged with bytes before it.
        let sample = samples()[sample];
        receive(&mut decoder, sample.frame().as_bytes());
        let received = receive(&mut decoder, sample.frame().as_bytes());
        prop_assert_eq!(received, (vec![as_decoded(sample.message)], 0));
    }

    #[test]
    fn the_outcome_does_not_depend_on_the_frames_before(
        pieces in proptest::collection::vec(piece(), 0..8),
        sample in 0..samples().len(),
    ) {
        // A zero resets the decoder.
        let mut used = Decoder::new();
        for piece in &pieces {
            receive(&mut used, &bytes_of(piece));
        }
        used.push(0);
        let frame = samples()[sample].frame();
        let from_used = receive(&mut used, frame.as_bytes());
        prop_assert_eq!(from_used, receive(&mut Decoder::new(), frame.as_bytes()));
    }

    #[test]
    fn any_packet_decodes_or_is_refused(
        kind in prop_oneof![0x00_u8..0x02, 0x10_u8..0x16, 0x20_u8..0x25],
        payload in proptest::collection::vec(0_u8..6, 0..46),
    ) {
        let packet = Packet { kind, payload: &payload };
        // Encoding the accepted message gives a frame with the same meaning.
        if let Some(message) = decode(packet) {
            let frame = match message {
                Either::ToBoard(message) => message.encode(),
                Either::ToHost(message) => message.encode(),
            };
            let (accepted, _) = receive(&mut Decoder::new(), frame.as_bytes());
            prop_assert_eq!(accepted, vec![as_decoded(message)]);
        }
    }
}
