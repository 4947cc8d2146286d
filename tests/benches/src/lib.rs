//! Benchmarks with Criterion: `cargo bench -p singletrack-benches --bench NAME`.
