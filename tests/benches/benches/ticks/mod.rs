//! The cost of ticks, of a drive that goes on.
//!
//! Criterion reports the mean. Its percentiles are of batches; those of single ticks, which a
//! control period must hold, are measured and printed before it. `TICKS` is their number. Where benches
//! are tested and not measured, some ticks show that they run.

use std::{hint::black_box, time::Instant};

use criterion::Criterion;

/// Percentiles of single ticks, and the mean by Criterion.
pub(crate) fn measure<T>(criterion: &mut Criterion, name: &str, mut tick: impl FnMut() -> T) {
    let is_measured = std::env::args().any(|word| word == "--bench");
    let usual = if is_measured { 20_000_u32 } else { 20 };
    let mut wanted = std::env::args()
        .skip(1)
        .filter(|word| !word.starts_with('-'));
    if wanted.next().is_some_and(|wanted| !name.contains(&wanted)) {
        return;
    }
    let ticks = std::env::var("TICKS")
        .ok()
        .and_then(|ticks| ticks.parse().ok());
    let mut microseconds: Vec<f64> = (0..ticks.unwrap_or(usual))
        .map(|_| {
            let begin = Instant::now();
            black_box(tick());
            begin.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    microseconds.sort_by(f64::total_cmp);
    let at = |share: f64| microseconds[((microseconds.len() - 1) as f64 * share) as usize];
    println!(
        "{name}: p50 {:.2} us, p99 {:.2} us, largest {:.2} us of {} ticks",
        at(0.5),
        at(0.99),
        at(1.0),
        microseconds.len()
    );
    criterion.bench_function(name, |bencher| bencher.iter(|| black_box(tick())));
}
