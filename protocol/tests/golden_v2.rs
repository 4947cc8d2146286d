//! The frozen bytes of version 2, which this version no longer speaks.
//!
//! A greeting of version 2 is still understood, so that both sides can name each
//! other's version. Version 3 changed no layout: it added a message and values of
//! enumerations. What version 2 says has the same meaning, and what it does not say
//! it refuses.

#![expect(clippy::unwrap_used, reason = "helpers of tests may fail loudly")]

use singletrack_protocol::{BoardMode, DecodeError, Decoder, Hello, StopCause, ToBoard, ToHost};

use crate::samples::{Either, samples};

const GOLDEN: [(&str, &str); 12] = [
    ("hello to the board", "03010201090102d4c3b2a1311400"),
    (
        "configure",
        "0c1003d205d1fc4c0471075a0104dc0519067e04080728061405d0203c0250027802640fc409580201840301018c0a1147030404894900",
    ),
    ("arm", "0d11044433221188776655176d00"),
    ("disarm", "051205cbfe00"),
    ("drive", "0713c88d012af305ffffff0c040118c200"),
    ("emergency stop", "051406809800"),
    ("hello to the host", "03010201090102d4c3b2a1311400"),
    (
        "telemetry",
        "05205634120b0302c8012588ffd5030e02050afafff301ff3ffdff2c010af89101c6041906054800",
    ),
    (
        "status",
        "05216034120cccbbaa990301f41ce9030c0203030a0402050206067b13010107073c05020b57ad00",
    ),
    ("acknowledgement", "0a2201044433221169ed00"),
    ("refusal", "022305030fdf8400"),
    ("identity", "06241147641c00"),
];

#[test]
fn a_greeting_of_version_2_is_understood_in_both_directions() {
    let hello = Hello {
        protocol_version: 2,
        software_version: [0, 1, 2],
        nonce: 0xA1B2_C3D4,
    };
    let bytes = |name| GOLDEN.iter().find(|(other, _)| *other == name).unwrap().1;
    let mut decoder = Decoder::new();
    let greeting = packet(&mut decoder, bytes("hello to the board"));
    assert_eq!(ToBoard::decode(greeting), Ok(hello.into()));
    let greeting = packet(&mut decoder, bytes("hello to the host"));
    assert_eq!(ToHost::decode(greeting), Ok(hello.into()));
}

#[test]
fn every_other_message_of_version_2_still_means_the_same() {
    for (name, golden) in GOLDEN {
        if name.starts_with("hello") {
            continue;
        }
        let sample = samples().into_iter().find(|sample| sample.name == name);
        let mut decoder = Decoder::new();
        let packet = packet(&mut decoder, golden);
        let sample = sample.unwrap();
        assert_eq!(
            sample.decode_same_direction(packet),
            Ok(sample.message),
            "{name}"
        );
    }
}

#[test]
fn what_version_3_added_lies_beyond_the_numbers_of_version_2() {
    // Version 2 knew seven modes, nine causes and the types up to 0x14 to the board.
    assert_eq!(BoardMode::Jogging as u8, 7);
    assert_eq!(StopCause::JogTimeout as u8, 9);
    let jog = samples().into_iter().find(|sample| sample.name == "jog");
    let Either::ToBoard(jog) = jog.unwrap().message else {
        panic!("a jog goes to the board");
    };
    let mut decoder = Decoder::new();
    let frame = jog.encode();
    let (&last, head) = frame.as_bytes().split_last().unwrap();
    for &byte in head {
        decoder.push(byte);
    }
    let packet = decoder.push(last).unwrap().unwrap();
    assert_eq!(
        ToHost::decode(packet),
        Err(DecodeError::UnknownType(0x15)),
        "a line that echoes"
    );
}

fn packet<'a>(decoder: &'a mut Decoder, golden: &str) -> singletrack_protocol::Packet<'a> {
    let mut bytes = unhex(golden);
    let last = bytes.pop().unwrap();
    for byte in bytes {
        assert_eq!(decoder.push(byte), None);
    }
    decoder.push(last).unwrap().unwrap()
}

fn unhex(text: &str) -> Vec<u8> {
    (0..text.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap())
        .collect()
}
