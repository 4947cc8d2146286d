//! Packets captured from real Motive servers. The published package `natnet-decode`
//! contains them; they are read from the folder into which cargo unpacked it.

use std::{path::PathBuf, process::Command};

use singletrack_mocap::codec::{
    BitstreamVersion, Frame, ServerInfo, ServerMessage, UnsupportedVersion,
};

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
