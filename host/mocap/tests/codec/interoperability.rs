//! Other implementations: an independent decoder reads the encoded messages, and packets that were
//! captured from real Motive servers are decoded. The published package `natnet-decode` contains
//! them; they are read from the folder into which cargo unpacked it.

use core::{net::Ipv4Addr, num::NonZeroU64};
use std::{path::PathBuf, process::Command};

use natnet::{DataSet, Decoder, FrameOfData, Message, ParsePolicy, Version};
use proptest::prelude::*;
use singletrack_mocap::{
    codec::{
        BitstreamVersion, Connection, DataChannel, Frame, ServerInfo, ServerMessage,
        UnsupportedVersion,
    },
    encode,
};

use crate::{
    any_frame, encoded,
    models::{OwnedDataset, encode_all},
};

/// The versions that both decoders read.
const SHARED: [BitstreamVersion; 4] = [
    BitstreamVersion::V3_0,
    BitstreamVersion::V3_1,
    BitstreamVersion::V4_0,
    BitstreamVersion::V4_1,
];

fn decode(datagram: &[u8], version: BitstreamVersion) -> Message {
    Decoder::new(Version::from_bytes(version.to_wire()))
        .unwrap()
        .with_policy(ParsePolicy::Strict)
        .parse(datagram)
        .unwrap()
        .into_message()
}

fn frame_of(message: Message) -> FrameOfData {
    match message {
        Message::FrameOfData(frame) => *frame,
        other => panic!("not a frame: {other:?}"),
    }
}

proptest! {
    #[test]
    fn frames_are_read_to_the_same_values(frame in any_frame()) {
        for version in SHARED {
            let theirs = frame_of(decode(&frame.encode(version), version));
            prop_assert_eq!(theirs.frame_number, frame.number);
            prop_assert_eq!(theirs.rigid_bodies.len(), frame.rigid_bodies.len());
            for (theirs, ours) in theirs.rigid_bodies.iter().zip(&frame.rigid_bodies) {
                prop_assert_eq!(theirs.id, ours.id);
                prop_assert_eq!(theirs.position, ours.position_m);
                prop_assert_eq!(theirs.orientation, ours.orientation_xyzw);
                prop_assert_eq!(theirs.mean_marker_error, ours.mean_error_m);
                prop_assert_eq!(theirs.params, ours.params);
                prop_assert_eq!(theirs.tracking_valid(), ours.tracking_valid());
            }
            let names: Vec<_> = theirs.marker_sets.iter().map(|set| &set.name).collect();
            let expected: Vec<_> = frame.marker_sets.iter().map(|(name, _)| name).collect();
            prop_assert_eq!(names, expected);
            prop_assert_eq!(&theirs.other_markers, &frame.other_markers);
            prop_assert_eq!(theirs.labeled_markers.len(), frame.labelled_markers.len());
            prop_assert_eq!(theirs.skeletons.count as usize, frame.skeletons.len());
            prop_assert_eq!(theirs.force_plates.count as usize, frame.force_plates.len());
            prop_assert_eq!(theirs.devices.count as usize, frame.devices.len());
            let timing = theirs.timing;
            prop_assert_eq!([timing.timecode, timing.timecode_subframe], frame.timecode);
            prop_assert_eq!(timing.timestamp.to_bits(), frame.timestamp_s.to_bits());
            prop_assert_eq!(timing.camera_mid_exposure, frame.ticks.mid_exposure);
            prop_assert_eq!(timing.camera_data_received, frame.ticks.received);
            prop_assert_eq!(timing.transmit, frame.ticks.transmit);
            prop_assert_eq!(theirs.params, frame.flags.0);
            if version == BitstreamVersion::V4_1 {
                prop_assert_eq!(theirs.assets.count as usize, frame.assets.len());
                prop_assert_eq!(timing.precision_timestamp_secs, frame.precision_time.seconds);
            }
        }
    }
}

#[test]
fn model_definitions_are_read_to_the_same_values() {
    let marker = ([1.0, 2.0, 3.0], 5, "front".to_owned());
    let body = ("car".to_owned(), 42, -1, [0.1, 0.2, 0.3]);
    let datasets = [
        OwnedDataset::MarkerSet("all".to_owned(), vec!["a".to_owned(), "b".to_owned()]),
        OwnedDataset::RigidBody(body, vec![marker]),
    ];
    for version in SHARED {
        let datagram = encode_all(&datasets, version);
        let Message::ModelDef(theirs) = decode(&datagram, version) else {
            panic!("not model definitions");
        };
        let [DataSet::MarkerSet(set), DataSet::RigidBody(body)] = &theirs.datasets[..] else {
            panic!("not the datasets written: {theirs:?}");
        };
        assert_eq!(set.marker_names, ["a", "b"]);
        assert_eq!(body.name, "car");
        assert_eq!(body.id, 42);
        assert_eq!(body.parent_id, -1);
        assert_eq!(body.offset, [0.1, 0.2, 0.3]);
    }
}

#[test]
fn server_info_is_read_to_the_same_values() {
    let group = Ipv4Addr::new(239, 255, 42, 99);
    let info = ServerInfo {
        application: "Motive",
        application_version: [3, 1, 2, 1],
        natnet_version: [4, 1, 0, 0],
        connection: Some(Connection {
            ticks_per_second: NonZeroU64::new(10_000_000),
            data_channel: DataChannel {
                port: 1511,
                multicast: true,
                group,
            },
        }),
    };
    let datagram = encoded(|out| encode::server_info(&info, out));
    let Message::ServerInfo(theirs) = decode(&datagram, BitstreamVersion::V4_1) else {
        panic!("not a server info");
    };
    assert_eq!(theirs.application_name, "Motive");
    assert_eq!(theirs.server_version, Version::new(3, 1, 2, 1));
    assert_eq!(theirs.protocol_version, Version::V4_1);
    assert_eq!(theirs.high_res_clock_frequency, 10_000_000);
    assert_eq!(theirs.connection.data_port, 1511);
    assert!(theirs.connection.multicast);
    assert_eq!(theirs.multicast_group(), group);
}

/// The folder into which cargo unpacked `natnet-decode`.
fn package_folder() -> PathBuf {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--locked", "--format-version", "1"])
        .args(["--manifest-path", "tests/real-packets/Cargo.toml"])
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "`cargo fetch --manifest-path host/mocap/tests/real-packets/Cargo.toml` brings the \
         packets: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let manifest = metadata["packages"]
        .as_array()
        .unwrap()
        .iter()
        .find(|package| package["name"] == "natnet-decode")
        .and_then(|package| package["manifest_path"].as_str())
        .unwrap();
    PathBuf::from(manifest).parent().unwrap().to_owned()
}

fn packet(motive: &str, index: u32) -> Vec<u8> {
    let path = package_folder().join(format!("tests/data/frame-motive-{motive}-{index:03}.bin"));
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn server_info(datagram: &[u8]) -> ServerInfo<'_> {
    match ServerMessage::decode(datagram, BitstreamVersion::NEWEST).unwrap() {
        ServerMessage::ServerInfo(info) => info,
        other => panic!("not a server info: {other:?}"),
    }
}

fn frame(datagram: &[u8], version: BitstreamVersion) -> Frame<'_> {
    match ServerMessage::decode(datagram, version).unwrap() {
        ServerMessage::Frame(frame) => frame,
        other => panic!("not a frame: {other:?}"),
    }
}

#[track_caller]
fn assert_near(actual: f64, expected: f64, tolerance: f64) {
    assert!(
        (actual - expected).abs() <= tolerance,
        "{actual} is not {expected}"
    );
}

#[test]
fn motive_1_7_2_is_read_at_2_7() {
    let greeting = packet("1.7.2", 0);
    let info = server_info(&greeting);
    assert_eq!(info.application, "NatNetLib");
    assert_eq!(info.connection, None);
    assert_eq!(info.bitstream(), Ok(BitstreamVersion::V2_7));

    for (index, number) in [(1, 411_213), (2, 411_214)] {
        let datagram = packet("1.7.2", index);
        let frame = frame(&datagram, BitstreamVersion::V2_7);
        assert_eq!(frame.number, number);
        assert_eq!(frame.sections.marker_sets, 2);
        assert_eq!(frame.sections.other_markers, 2);
        assert_eq!(frame.sections.labelled_markers, 3);
        assert_near(frame.timestamp_s, 3_426.776, 0.02);
        assert_eq!(frame.ticks, None);
        let bodies: Vec<_> = frame.rigid_bodies().collect();
        let [body] = bodies[..] else {
            panic!("not one body: {bodies:?}");
        };
        assert_eq!(body.id, 1);
        assert!(body.tracking_valid());
        for (actual, expected) in body.position_m.into_iter().zip([0.006, 0.0958, -1.4076]) {
            assert_near(actual.into(), expected, 1e-3);
        }
        let norm: f64 = body
            .orientation_xyzw
            .iter()
            .map(|q| f64::from(*q).powi(2))
            .sum();
        assert_near(norm, 1.0, 1e-5);
    }
}

#[test]
fn motive_1_9_0_is_read_at_2_9() {
    let greeting = packet("1.9.0", 0);
    assert_eq!(
        server_info(&greeting).bitstream(),
        Ok(BitstreamVersion::V2_9)
    );

    for (index, number) in [(1, 11_823_217), (2, 11_823_218)] {
        let datagram = packet("1.9.0", index);
        let frame = frame(&datagram, BitstreamVersion::V2_9);
        assert_eq!(frame.number, number);
        assert_eq!(frame.sections.force_plates, 0);
        assert_eq!(frame.sections.labelled_markers, 3);
        let bodies: Vec<_> = frame.rigid_bodies().collect();
        let [body] = bodies[..] else {
            panic!("not one body: {bodies:?}");
        };
        assert_eq!(body.id, 2);
        assert!(body.tracking_valid());
        for (actual, expected) in body.position_m.into_iter().zip([0.2453, 0.017, 0.2202]) {
            assert_near(actual.into(), expected, 1e-3);
        }
    }
}

#[test]
fn motive_1_5_0_is_refused_by_its_version_and_its_frames_fit_no_other() {
    let greeting = packet("1.5.0", 0);
    let info = server_info(&greeting);
    assert_eq!(
        info.bitstream(),
        Err(UnsupportedVersion { major: 2, minor: 5 })
    );
    for index in [1, 2] {
        let datagram = packet("1.5.0", index);
        for version in crate::all_versions() {
            assert!(ServerMessage::decode(&datagram, version).is_err());
        }
    }
}
