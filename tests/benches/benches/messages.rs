//! Time to decode a camera frame of ten bodies, and to encode and decode a frame of the serial line
//! on the host.

#[path = "../../../protocol/tests/samples/mod.rs"]
mod samples;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use singletrack_mocap::{
    codec::{BitstreamVersion, CameraTicks, RigidBody, ServerMessage},
    encode::{self, FrameContent},
};
use singletrack_protocol::{Decoder, ToBoard, ToHost};

/// A frame of ten bodies.
fn ten_bodies(version: BitstreamVersion) -> Vec<u8> {
    let bodies: Vec<_> = (0_u8..10)
        .map(|id| RigidBody::tracked(id.into(), [f32::from(id), 0.5, 0.1], [0.0, 0.0, 0.0, 1.0]))
        .collect();
    let content = FrameContent {
        number: 1_234,
        rigid_bodies: &bodies,
        timestamp_s: 12.5,
        ticks: CameraTicks {
            mid_exposure: 1_000,
            received: 2_000,
            transmit: 3_000,
        },
        ..FrameContent::default()
    };
    let mut datagram = vec![0; 2_048];
    match encode::frame(version, &content, &mut datagram) {
        Ok(len) => datagram.truncate(len),
        Err(error) => unreachable!("{error}"),
    }
    datagram
}

fn decode(criterion: &mut Criterion) {
    for version in [BitstreamVersion::V3_0, BitstreamVersion::V4_1] {
        let datagram = ten_bodies(version);
        criterion.bench_function(&format!("natnet {version}: 10 bodies"), |bencher| {
            bencher.iter(|| {
                let Ok(ServerMessage::Frame(frame)) =
                    ServerMessage::decode(black_box(&datagram), version)
                else {
                    unreachable!("the frame was encoded above");
                };
                frame.rigid_bodies().find(|body| body.id == 9)
            });
        });
    }
}

fn frames(criterion: &mut Criterion) {
    for sample in samples::samples() {
        if !["drive", "telemetry"].contains(&sample.name) {
            continue;
        }
        criterion.bench_function(&format!("encode {}", sample.name), |bencher| {
            bencher.iter(|| black_box(&sample).frame());
        });
        let frame = sample.frame();
        criterion.bench_function(&format!("decode {}", sample.name), |bencher| {
            let mut decoder = Decoder::new();
            bencher.iter(|| {
                let mut decoded = 0;
                for &byte in black_box(frame.as_bytes()) {
                    if let Some(Ok(packet)) = decoder.push(byte) {
                        decoded += usize::from(match sample.message {
                            samples::Either::ToBoard(_) => ToBoard::decode(packet).is_ok(),
                            samples::Either::ToHost(_) => ToHost::decode(packet).is_ok(),
                        });
                    }
                }
                assert_eq!(decoded, 1);
            });
        });
    }
}

criterion_group!(benches, decode, frames);
criterion_main!(benches);
