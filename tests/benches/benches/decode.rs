//! Time to decode a frame of ten bodies.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use singletrack_mocap::{
    codec::{BitstreamVersion, CameraTicks, RigidBody, ServerMessage},
    encode::{self, FrameContent},
};

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

criterion_group!(benches, decode);
criterion_main!(benches);
