//! The frozen bytes of version 3.
//!
//! If a test fails here, either the change is wrong, or `VERSION` must be
//! incremented and these bytes stay as the old version's. The bytes are never
//! corrected.

#![expect(clippy::unwrap_used, reason = "helpers of tests may fail loudly")]

use singletrack_protocol::{Decoder, Message, ToBoard, ToHost, VERSION};

use crate::samples::{Sample, samples};

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
