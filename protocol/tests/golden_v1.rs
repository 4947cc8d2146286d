//! The frozen bytes of version 1.
//!
//! If a test fails here, either the change is wrong, or `VERSION` must be
//! incremented and these bytes stay as the old version's. The bytes are never
//! corrected.

#![expect(clippy::unwrap_used, reason = "helpers of tests may fail loudly")]

mod samples;

use singletrack_protocol::{Decoder, Message, ToBoard, ToHost, VERSION};

use samples::{Sample, samples};

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

#[test]
fn every_message_has_the_bytes_of_version_1() {
    assert_eq!(VERSION, 1);
    let samples = samples();
    assert_eq!(samples.len(), GOLDEN.len());
    for (sample, (name, golden)) in samples.iter().zip(GOLDEN) {
        assert_eq!(sample.name, name);
        assert_eq!(hex(sample.frame().as_bytes()), golden, "{name}");
    }
}

#[test]
fn the_bytes_of_version_1_are_decoded() {
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
            samples::Either::ToBoard(message) => match message {
                ToBoard::Hello(m) => length(&m),
                ToBoard::Configure(m) => length(&m),
                ToBoard::Arm(m) => length(&m),
                ToBoard::Disarm(m) => length(&m),
                ToBoard::Drive(m) => length(&m),
                ToBoard::EmergencyStop(m) => length(&m),
            },
            samples::Either::ToHost(message) => match message {
                ToHost::Hello(m) => length(&m),
                ToHost::Telemetry(m) => length(&m),
                ToHost::Status(m) => length(&m),
                ToHost::Acknowledgement(m) => length(&m),
                ToHost::Refusal(m) => length(&m),
            },
        };
        assert_eq!(actual, declared, "{name}");
    }
}

#[test]
fn the_hash_of_a_configuration_is_frozen() {
    assert_eq!(samples::configuration().hash(), 0xE0F4_70B3);
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
