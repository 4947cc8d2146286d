//! Cost of encoding and decoding a frame on the host.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use singletrack_protocol::{Decoder, ToBoard, ToHost};

#[path = "../../../protocol/tests/samples/mod.rs"]
mod samples;

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

criterion_group!(benches, frames);
criterion_main!(benches);
