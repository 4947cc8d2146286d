//! Frames are decoded to the values that were encoded.

use proptest::prelude::*;
use singletrack_mocap::{
    codec::{BitstreamVersion, RigidBody, SectionCounts, ServerMessage},
    encode::{self, Asset, EncodeError, FrameContent, Sections},
};

use crate::{
    all_versions,
    strategies::{AnyFrame, any_frame},
};

fn assert_round_trip(frame: &AnyFrame, version: BitstreamVersion) {
    let datagram = frame.encode(version);
    let Ok(ServerMessage::Frame(decoded)) = ServerMessage::decode(&datagram, version) else {
        panic!("{version}: {:?}", ServerMessage::decode(&datagram, version));
    };
    let at_least = |major, minor| version >= BitstreamVersion::new(major, minor).unwrap();
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
fn a_section_that_the_version_does_not_have_is_refused_by_name() {
    let content = FrameContent {
        sections: Sections {
            assets: &[Asset {
                id: 1,
                rigid_bodies: &[],
                markers: &[],
            }],
            ..Sections::default()
        },
        ..FrameContent::default()
    };
    assert_eq!(
        encode::frame(BitstreamVersion::V4_0, &content, &mut [0; 256]),
        Err(EncodeError::NotInVersion {
            field: "assets",
            version: BitstreamVersion::V4_0
        })
    );
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
