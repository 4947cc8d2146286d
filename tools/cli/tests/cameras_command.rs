//! `singletrack cameras` and the diagnosis, against servers of every kind on real sockets.

use std::{net::Ipv4Addr, process::Command, time::Duration};

use rtrb::RingBuffer;
use serde_json::Value;
use singletrack_core::{
    cameras::{CameraReceiver, CameraReport},
    config::{MotionCaptureSection, ServerKind, UpAxis},
};
use singletrack_mocap::planar::PlanarSession;
use singletrack_sim::{RealTimeConfig, RealTimeSimulator, UdpConfig};
use singletrackd::{MocapSockets, monotonic_ns};

fn simulator(kind: ServerKind) -> RealTimeSimulator {
    RealTimeSimulator::start(RealTimeConfig {
        cameras: match kind {
            ServerKind::NatNet => singletrack_sim::ServerKind::NatNet,
            ServerKind::Vrpn => singletrack_sim::ServerKind::Vrpn,
            ServerKind::Qualisys => singletrack_sim::ServerKind::Qualisys,
        },
        udp: UdpConfig::default(),
        ..RealTimeConfig::default()
    })
    .unwrap()
}

fn section(kind: ServerKind, simulator: &RealTimeSimulator) -> MotionCaptureSection {
    MotionCaptureSection {
        kind,
        command_port: Some(simulator.command_address.port()),
        ..MotionCaptureSection::new(Ipv4Addr::LOCALHOST, "car", UpAxis::Y)
    }
}

/// What the receiver says of the cameras within a time.
fn diagnoses(section: &MotionCaptureSection, within: Duration) -> Vec<singletrack_api::Cameras> {
    let (observations, _observed) = RingBuffer::new(4_096);
    let (reports_in, mut reports) = RingBuffer::new(4_096);
    let session = PlanarSession::new(section.session().unwrap()).unwrap();
    let offset_ns = std::sync::Arc::default();
    let mut receiver =
        CameraReceiver::new(session, offset_ns, observations, reports_in, None, 0.05);
    let mut sockets = MocapSockets::open(section).unwrap();
    let until_ns = monotonic_ns() + within.as_nanos() as u64;
    let mut found = Vec::new();
    while monotonic_ns() < until_ns {
        receiver.poll(&monotonic_ns, &mut sockets, &mut |_| {});
        while let Ok(report) = reports.pop() {
            if let CameraReport::Diagnosis(diagnosis) = report {
                found.push(diagnosis);
            }
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    found
}

/// Runs the command, and returns whether it succeeded and what it printed.
fn cameras(kind: ServerKind, port: u16, within: &str, more: &[&str]) -> (bool, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_singletrack"))
        .args(["cameras", "--server", "127.0.0.1", "--kind", kind.name()])
        .args([
            "--up-axis",
            "y",
            "--for",
            within,
            "--port",
            &port.to_string(),
        ])
        .args(more)
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    (output.status.success(), text)
}

#[test]
fn the_bodies_of_every_kind_of_server_are_listed_with_rate_noise_and_latency() {
    for kind in ServerKind::ALL {
        let simulator = simulator(kind);
        let port = simulator.command_address.port();
        let (is_good, text) = cameras(kind, port, "3s", &["--format", "json"]);
        assert!(is_good, "{text}");
        let report: Value = serde_json::from_str(&text).unwrap();
        let bodies = report["bodies"].as_array().unwrap();
        let named = |name| bodies.iter().find(|body| body["name"] == name).unwrap();
        let car = named("car");
        let number = |value: &Value| value.as_f64().unwrap();
        assert!(
            (20.0..110.0).contains(&number(&car["rate_hz"])),
            "{kind:?}: {car}"
        );
        assert!(
            (0.1..1.0).contains(&number(&car["spread_mm"])),
            "{kind:?}: {car}"
        );
        assert_eq!(car["remarks"].as_array().unwrap().len(), 0);
        // What does not move at all is not measured.
        assert_eq!(named("wand")["remarks"].as_array().unwrap().len(), 1);
        let times = &report["times"];
        let off_ms = number(&times["latency_ms"]) - 9.0;
        // A busy machine adds to the latency.
        assert!((-5.0..20.0).contains(&off_ms), "{kind:?}: {times}");
        let expected = match kind {
            ServerKind::Qualisys => "frame-timestamp",
            ServerKind::NatNet | ServerKind::Vrpn => "mid-exposure-echo",
        };
        assert_eq!(times["source"], expected);
    }
}

#[test]
fn a_wrong_name_names_the_bodies_of_every_kind_of_server() {
    for kind in [ServerKind::Vrpn, ServerKind::Qualisys] {
        let simulator = simulator(kind);
        let section = MotionCaptureSection {
            rigid_body: "kart".to_owned(),
            ..section(kind, &simulator)
        };
        let found = diagnoses(&section, Duration::from_millis(2_500));
        let last = found.last().unwrap();
        assert_eq!(last.diagnosis, "no-such-body", "{kind:?}: {last}");
        for name in ["\"kart\"", "\"wand\", \"carrier\", \"car\""] {
            assert!(last.text.contains(name), "{kind:?}: {last}");
        }
    }
}

#[test]
fn the_wrong_kind_and_the_wrong_port_are_told_apart() {
    let vrpn = simulator(ServerKind::Vrpn);
    let as_qualisys = section(ServerKind::Qualisys, &vrpn);
    let found = diagnoses(&as_qualisys, Duration::from_millis(4_500));
    let last = found.last().unwrap();
    assert_eq!(last.diagnosis, "unsupported-version", "{last}");
    assert!(last.text.contains("motion_capture.kind"), "{last}");
    let port = vrpn.command_address.port();
    let (is_good, text) = cameras(ServerKind::Qualisys, port, "3s", &[]);
    assert!(!is_good && text.contains("something else"), "{text}");
    drop(vrpn);
    let (is_good, text) = cameras(ServerKind::Vrpn, port, "1s", &[]);
    assert!(!is_good && text.contains("nothing answers"), "{text}");
    let nobody = MotionCaptureSection {
        kind: ServerKind::Vrpn,
        ..as_qualisys
    };
    let found = diagnoses(&nobody, Duration::from_millis(3_500));
    let last = found.last().unwrap();
    assert_eq!(last.diagnosis, "no-server", "{last}");
    assert!(last.text.contains("TCP port"), "{last}");
}
