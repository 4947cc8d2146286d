//! The codec: encoded messages are decoded to the same values, damaged ones are
//! refused, and other implementations agree in both directions.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "test helpers fail the test that calls them"
)]

mod interoperability;
mod messages;
mod models;
mod round_trip;
mod strategies;

use singletrack_mocap::codec::BitstreamVersion;

/// Every named version, and one after 2.11.
fn all_versions() -> Vec<BitstreamVersion> {
    [
        (2, 7),
        (2, 8),
        (2, 9),
        (2, 10),
        (2, 11),
        (3, 0),
        (3, 1),
        (4, 0),
        (4, 1),
        (4, 2),
        (4, 3),
        (4, 4),
    ]
    .into_iter()
    .map(|(major, minor)| BitstreamVersion::new(major, minor).unwrap())
    .collect()
}

/// The datagram with the length in its header corrected.
fn with_fitting_header(mut datagram: Vec<u8>) -> Vec<u8> {
    let len = u16::try_from(datagram.len() - 4).unwrap();
    datagram[2..4].copy_from_slice(&len.to_le_bytes());
    datagram
}

/// The output of an encoder for a sufficient buffer.
fn encoded<E: core::fmt::Debug>(encode: impl FnOnce(&mut [u8]) -> Result<usize, E>) -> Vec<u8> {
    let mut buffer = vec![0xAA; 65_536];
    let len = encode(&mut buffer).unwrap();
    buffer.truncate(len);
    buffer
}
