//! The frozen bytes of version 1, which this version no longer speaks.
//!
//! A greeting of version 1 is still understood, so that both sides can name each
//! other's version. A message whose layout has changed since is refused by its length,
//! and never read with another meaning.

#![expect(clippy::unwrap_used, reason = "helpers of tests may fail loudly")]

use singletrack_protocol::{DecodeError, Decoder, Hello, ToBoard, ToHost};

const GOLDEN: [(&str, &str); 11] = [
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
    for (name, golden) in GOLDEN {
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
    for (name, golden) in GOLDEN {
        let mut decoder = Decoder::new();
        let packet = packet(&mut decoder, golden);
        let refused = |error: &DecodeError| matches!(error, DecodeError::Length { .. });
        let refused = ToBoard::decode(packet).is_err_and(|error| refused(&error))
            || ToHost::decode(packet).is_err_and(|error| refused(&error));
        assert_eq!(refused, CHANGED.contains(&name), "{name}");
    }
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
