//! Frames are decoded to the values that were encoded; damaged and invented datagrams are refused.

use proptest::{collection::vec, prelude::*};
use singletrack_mocap::{
    codec::{
        BitstreamVersion, ClientMessage, DecodeError, PrecisionTime, RigidBody, SectionCounts,
        ServerMessage,
    },
    encode::{self, EncodeError, FrameContent, MarkerSet},
};

use crate::{AnyFrame, all_versions, any_frame, at_least, encoded, with_fitting_header};

fn assert_round_trip(frame: &AnyFrame, version: BitstreamVersion) {
    let datagram = frame.encode(version);
    let Ok(ServerMessage::Frame(decoded)) = ServerMessage::decode(&datagram, version) else {
        panic!("{version}: {:?}", ServerMessage::decode(&datagram, version));
    };
    let at_least = |major, minor| at_least(version, major, minor);
    assert_eq!(decoded.number, frame.number);
    assert_eq!(
        decoded.rigid_bodies().collect::<Vec<RigidBody>>(),
        frame.rigid_bodies
    );
    let when = |exists: bool, count: usize| if exists { count } else { 0 };
    assert_eq!(
        decoded.sections,
        SectionCounts {
            marker_sets: frame.marker_sets.len(),
            other_markers: frame.other_markers.len(),
            rigid_bodies: frame.rigid_bodies.len(),
            skeletons: frame.skeletons.len(),
            assets: when(at_least(4, 1), frame.assets.len()),
            labelled_markers: frame.labelled_markers.len(),
            force_plates: when(at_least(2, 9), frame.force_plates.len()),
            devices: when(at_least(2, 11), frame.devices.len()),
        }
    );
    assert_eq!(decoded.timecode, frame.timecode);
    assert_eq!(decoded.timestamp_s.to_bits(), frame.timestamp_s.to_bits());
    assert_eq!(decoded.ticks, at_least(3, 0).then_some(frame.ticks));
    assert_eq!(
        decoded.precision_time,
        at_least(4, 1).then_some(frame.precision_time)
    );
    assert_eq!(decoded.latency, (!at_least(3, 0)).then_some(frame.latency));
    assert_eq!(decoded.flags, frame.flags);
}

proptest! {
    #[test]
    fn a_frame_of_any_version_is_decoded_to_what_was_encoded(frame in any_frame()) {
        for version in all_versions() {
            assert_round_trip(&frame, version);
        }
    }

    /// The frames are without the sections that the encoder does not write.
    #[test]
    fn the_encoder_writes_the_same_bytes(frame in any_frame()) {
        let frame = AnyFrame {
            body_markers: vec![],
            other_markers: vec![],
            skeletons: vec![],
            assets: vec![],
            force_plates: vec![],
            devices: vec![],
            timecode: [0; 2],
            precision_time: PrecisionTime::default(),
            ..frame
        };
        let marker_sets: Vec<_> = frame
            .marker_sets
            .iter()
            .map(|(name, markers_m)| MarkerSet { name, markers_m })
            .collect();
        let content = FrameContent {
            number: frame.number,
            marker_sets: &marker_sets,
            rigid_bodies: &frame.rigid_bodies,
            labelled_markers: &frame.labelled_markers,
            timestamp_s: frame.timestamp_s,
            ticks: frame.ticks,
            latency: frame.latency,
            flags: frame.flags,
        };
        for version in all_versions() {
            let datagram = encoded(|out| encode::frame(version, &content, out));
            prop_assert_eq!(datagram, frame.encode(version));
        }
    }
}

#[test]
fn the_tail_of_a_frame_has_the_documented_length() {
    let empty =
        |version| crate::encoded(|out| encode::frame(version, &FrameContent::default(), out)).len();
    // Header, number; then a count for each section, and a size from 4.1 on.
    assert_eq!(empty(BitstreamVersion::V3_0), 4 + 4 + 7 * 4 + 46);
    assert_eq!(empty(BitstreamVersion::V4_0), 4 + 4 + 7 * 4 + 46);
    assert_eq!(empty(BitstreamVersion::V4_1), 4 + 4 + 8 * 8 + 54);
}

#[test]
fn a_buffer_of_any_smaller_size_is_refused() {
    let bodies = [RigidBody::tracked(1, [0.0; 3], [0.0, 0.0, 0.0, 1.0])];
    let content = FrameContent {
        rigid_bodies: &bodies,
        ..FrameContent::default()
    };
    for version in all_versions() {
        let len = crate::encoded(|out| encode::frame(version, &content, out)).len();
        for capacity in 0..len {
            assert!(matches!(
                encode::frame(version, &content, &mut vec![0; capacity]),
                Err(EncodeError::BufferTooSmall { .. })
            ));
        }
    }
}

/// Decodes a datagram and reads every value of the message.
fn exercise(datagram: &[u8], version: BitstreamVersion) {
    let _ = ClientMessage::decode(datagram);
    match ServerMessage::decode(datagram, version) {
        Ok(ServerMessage::Frame(frame)) => {
            assert_eq!(frame.rigid_bodies().count(), frame.sections.rigid_bodies);
        }
        Ok(ServerMessage::ModelDefinitions(definitions)) => {
            assert!(definitions.rigid_bodies().count() <= definitions.dataset_count);
        }
        Ok(_) | Err(_) => {}
    }
}

fn one_body(version: BitstreamVersion) -> Vec<u8> {
    let bodies = [RigidBody::tracked(7, [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0])];
    let content = FrameContent {
        number: 1,
        rigid_bodies: &bodies,
        ..FrameContent::default()
    };
    encoded(|out| encode::frame(version, &content, out))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn every_strict_prefix_of_a_frame_is_refused(frame in any_frame()) {
        for version in all_versions() {
            let datagram = frame.encode(version);
            for len in 0..datagram.len() {
                let prefix = datagram[..len].to_vec();
                prop_assert!(ServerMessage::decode(&prefix, version).is_err());
                if len >= 4 {
                    let prefix = with_fitting_header(prefix);
                    prop_assert!(ServerMessage::decode(&prefix, version).is_err());
                }
            }
        }
    }

    #[test]
    fn bytes_after_a_frame_are_refused(frame in any_frame(), surplus in vec(any::<u8>(), 1..64)) {
        for version in all_versions() {
            let mut datagram = frame.encode(version);
            let len = datagram.len();
            datagram.extend_from_slice(&surplus);
            prop_assert_eq!(
                ServerMessage::decode(&datagram, version).unwrap_err(),
                DecodeError::LengthMismatch {
                    declared: len - 4,
                    actual: datagram.len() - 4,
                }
            );
            prop_assert_eq!(
                ServerMessage::decode(&with_fitting_header(datagram), version).unwrap_err(),
                DecodeError::TrailingBytes {
                    field: "the frame",
                    offset: len,
                    count: surplus.len(),
                }
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn random_bytes_never_panic(id in 0_u16..16, payload in vec(any::<u8>(), 0..400)) {
        let mut datagram = id.to_le_bytes().to_vec();
        datagram.extend_from_slice(&[0, 0]);
        datagram.extend_from_slice(&payload);
        let datagram = with_fitting_header(datagram);
        for version in all_versions() {
            exercise(&datagram, version);
            exercise(&payload, version);
        }
    }

    #[test]
    fn random_damage_never_panics(
        frame in any_frame(),
        damage in vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        for version in all_versions() {
            let mut datagram = frame.encode(version);
            for (index, byte) in &damage {
                *index.get_mut(&mut datagram) = *byte;
            }
            exercise(&datagram, version);
            exercise(&with_fitting_header(datagram), version);
        }
    }
}

/// Where the size of the rigid-body section is when the two sections before it
/// are empty: header, number, twice count and size, count.
const BODIES_SIZE_OFFSET: usize = 4 + 4 + 2 * 8 + 4;

fn with_bodies_size(size: i32) -> Result<(), DecodeError> {
    let version = BitstreamVersion::V4_1;
    let mut datagram = one_body(version);
    datagram[BODIES_SIZE_OFFSET..BODIES_SIZE_OFFSET + 4].copy_from_slice(&size.to_le_bytes());
    ServerMessage::decode(&datagram, version).map(drop)
}

#[test]
fn a_section_must_have_its_declared_size() {
    assert_eq!(with_bodies_size(38), Ok(()));
    assert_eq!(
        with_bodies_size(37),
        Err(DecodeError::ImplausibleCount {
            field: "rigid body count",
            offset: BODIES_SIZE_OFFSET - 4,
            count: 1,
            available: 37,
        })
    );
    assert_eq!(
        with_bodies_size(42),
        Err(DecodeError::TrailingBytes {
            field: "rigid body count",
            offset: BODIES_SIZE_OFFSET + 4 + 38,
            count: 4,
        })
    );
    assert_eq!(
        with_bodies_size(-1),
        Err(DecodeError::NegativeCount {
            field: "section size",
            offset: BODIES_SIZE_OFFSET,
            value: -1,
        })
    );
}

#[test]
fn an_impossible_count_is_refused_before_any_entry_is_read() {
    let mut datagram = one_body(BitstreamVersion::V3_0);
    // Header, number: the number of marker sets.
    datagram[8..12].copy_from_slice(&i32::MAX.to_le_bytes());
    assert!(matches!(
        ServerMessage::decode(&datagram, BitstreamVersion::V3_0),
        Err(DecodeError::ImplausibleCount { offset: 8, .. })
    ));
}

#[test]
fn a_frame_read_as_another_version_is_refused() {
    for written in all_versions() {
        let datagram = one_body(written);
        for read in all_versions() {
            let same_layout = {
                let content = FrameContent::default();
                encoded(|out| encode::frame(written, &content, out))
                    == encoded(|out| encode::frame(read, &content, out))
                    && one_body(read) == datagram
            };
            assert_eq!(
                ServerMessage::decode(&datagram, read).is_ok(),
                same_layout,
                "written as {written}, read as {read}"
            );
        }
    }
}

#[test]
fn an_end_tag_other_than_zero_names_its_offset() {
    let mut datagram = one_body(BitstreamVersion::V4_1);
    let offset = datagram.len() - 4;
    datagram[offset] = 9;
    assert_eq!(
        ServerMessage::decode(&datagram, BitstreamVersion::V4_1).unwrap_err(),
        DecodeError::EndTag { offset, value: 9 }
    );
}
