//! The protocol, as its users see it, and the frozen bytes of every version; this one speaks
//! version 3.
//!
//! If a test fails here, either the change is wrong, or `VERSION` must be
//! incremented and these bytes stay as the old version's. The bytes are never
//! corrected.
//!
//! A greeting of version 2 is still understood, so that both sides can name each
//! other's version. Version 3 changed no layout: it added a message and values of
//! enumerations. What version 2 says has the same meaning, and what it does not say
//! it refuses.
//!
//! A greeting of version 1 is still understood, so that both sides can name each
//! other's version. A message whose layout has changed since is refused by its length,
//! and never read with another meaning.

#![expect(clippy::unwrap_used, reason = "helpers of tests may fail loudly")]

mod configuration;
mod damage;
mod samples;

use singletrack_protocol::{
    BoardMode, DecodeError, Decoder, Hello, Message, StopCause, ToBoard, ToHost, VERSION,
};

use crate::samples::{Either, Sample, samples};

const GOLDEN: [(&str, &str); 13] = [
    ("hello to the board", "03010301090102d4c3b2a1cc5900"),
    (
        "configure",
        "0c1003d205d1fc4c0471075a0104dc0519067e04080728061405d0203c0250027802640fc409580201840301018c0a1147030404894900",
    ),
    ("arm", "0d11044433221188776655176d00"),
    ("disarm", "051205cbfe00"),
    ("drive", "0713c88d012af305ffffff0c040118c200"),
    ("emergency stop", "051406809800"),
    ("jog", "0d15c90d0c0b0a64050906433700"),
    ("hello to the host", "03010301090102d4c3b2a1cc5900"),
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
fn every_message_has_the_bytes_of_version_3() {
    assert_eq!(VERSION, 3);
    let samples = samples();
    assert_eq!(samples.len(), GOLDEN.len());
    for (sample, (name, golden)) in samples.iter().zip(GOLDEN) {
        assert_eq!(sample.name, name);
        assert_eq!(hex(sample.frame().as_bytes()), golden, "{name}");
    }
}

#[test]
fn the_bytes_of_version_3_are_decoded() {
    for (sample, (name, golden)) in samples().iter().zip(GOLDEN) {
        let mut decoder = Decoder::new();
        let mut bytes = unhex(golden);
        let last = bytes.pop().unwrap();
        for byte in bytes {
            assert_eq!(decoder.push(byte), None, "{name}");
        }
        let packet = decoder.push(last).unwrap().unwrap();
        assert_eq!(
            sample.decode_same_direction(packet),
            Ok(sample.message),
            "{name}"
        );
    }
}

#[test]
fn every_payload_has_the_length_in_its_message_trait() {
    fn length<M: Message>(message: &M) -> (usize, usize) {
        (
            postcard::to_slice(message, &mut [0; 64]).unwrap().len(),
            M::PAYLOAD_LENGTH,
        )
    }
    for Sample { name, message } in samples() {
        let (actual, declared) = match message {
            crate::samples::Either::ToBoard(message) => match message {
                ToBoard::Hello(m) => length(&m),
                ToBoard::Configure(m) => length(&m),
                ToBoard::Arm(m) => length(&m),
                ToBoard::Disarm(m) => length(&m),
                ToBoard::Drive(m) => length(&m),
                ToBoard::EmergencyStop(m) => length(&m),
                ToBoard::Jog(m) => length(&m),
            },
            crate::samples::Either::ToHost(message) => match message {
                ToHost::Hello(m) => length(&m),
                ToHost::Telemetry(m) => length(&m),
                ToHost::Status(m) => length(&m),
                ToHost::Acknowledgement(m) => length(&m),
                ToHost::Refusal(m) => length(&m),
                ToHost::Identity(m) => length(&m),
            },
        };
        assert_eq!(actual, declared, "{name}");
    }
}

#[test]
fn the_hash_of_a_configuration_is_frozen() {
    assert_eq!(crate::samples::configuration().hash(), 0x0D12_C500);
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn unhex(text: &str) -> Vec<u8> {
    (0..text.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap())
        .collect()
}

const GOLDEN_V2: [(&str, &str); 12] = [
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
    let bytes = |name| {
        GOLDEN_V2
            .iter()
            .find(|(other, _)| *other == name)
            .unwrap()
            .1
    };
    let mut decoder = Decoder::new();
    let greeting = packet(&mut decoder, bytes("hello to the board"));
    assert_eq!(ToBoard::decode(greeting), Ok(hello.into()));
    let greeting = packet(&mut decoder, bytes("hello to the host"));
    assert_eq!(ToHost::decode(greeting), Ok(hello.into()));
}

#[test]
fn every_other_message_of_version_2_still_means_the_same() {
    for (name, golden) in GOLDEN_V2 {
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

const GOLDEN_V1: [(&str, &str); 11] = [
    ("hello to the board", "03010101090102d4c3b2a136c200"),
    (
        "configure",
        "0c1003d205d1fc4c0471075a04dc0519067e04080728061405d0203c0250027802640bc4095802018403019b7800",
    ),
    ("arm", "0d11044433221188776655176d00"),
    ("disarm", "051205cbfe00"),
    ("drive", "0713c88d012af305ffffff0c0302fb00"),
    ("emergency stop", "051406809800"),
    ("hello to the host", "03010101090102d4c3b2a136c200"),
    (
        "telemetry",
        "05205634120b0302c8012588ffd5030e02050afafff301ff3ffdff2c010af89101c6041906054800",
    ),
    (
        "status",
        "05216034120cccbbaa990301f41ce9030c0203030a040205020603a27000",
    ),
    ("acknowledgement", "0a2201044433221169ed00"),
    ("refusal", "0223050303b34e00"),
];

/// What changed its layout with version 2.
const CHANGED: [&str; 3] = ["configure", "drive", "status"];

#[test]
fn a_greeting_of_version_1_is_understood_in_both_directions() {
    for (name, golden) in GOLDEN_V1 {
        let hello = Hello {
            protocol_version: 1,
            software_version: [0, 1, 2],
            nonce: 0xA1B2_C3D4,
        };
        let mut decoder = Decoder::new();
        match name {
            "hello to the board" => {
                let packet = packet(&mut decoder, golden);
                assert_eq!(ToBoard::decode(packet), Ok(hello.into()));
            }
            "hello to the host" => {
                let packet = packet(&mut decoder, golden);
                assert_eq!(ToHost::decode(packet), Ok(hello.into()));
            }
            _ => {}
        }
    }
}

#[test]
fn a_message_with_another_layout_since_is_refused_by_its_length() {
    for (name, golden) in GOLDEN_V1 {
        let mut decoder = Decoder::new();
        let packet = packet(&mut decoder, golden);
        let refused = |error: &DecodeError| matches!(error, DecodeError::Length { .. });
        let refused = ToBoard::decode(packet).is_err_and(|error| refused(&error))
            || ToHost::decode(packet).is_err_and(|error| refused(&error));
        assert_eq!(refused, CHANGED.contains(&name), "{name}");
    }
}
