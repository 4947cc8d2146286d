//! Simulated seconds per second, with a host that only receives.
//!
//! Criterion reports it as throughput in "elements".

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]
#![allow(missing_docs, reason = "criterion_group writes a public function")]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use singletrack_sim::{SimulationConfig, World};

fn idle_host(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("simulated_seconds");
    group.throughput(Throughput::Elements(1));
    group.bench_function("idle_host", |bencher| {
        let mut world = World::new(SimulationConfig::default()).unwrap();
        let mut bytes = Vec::new();
        bencher.iter(|| {
            for _ in 0..100 {
                world.advance_to(world.now_us + 10_000);
                bytes.clear();
                world.host_read(&mut bytes);
                while world.poll_camera_frame().is_some() {}
            }
        });
    });
    group.finish();
}

criterion_group!(benches, idle_host);
criterion_main!(benches);
