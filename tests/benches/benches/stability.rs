//! The computation time of the paper's stability figures, on one core.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use singletrack_analysis::stability::{
    Belief, ClosedLoop, Law, MarginLimits, SampledLoop, Timing, hopf_points,
};
use singletrack_control::VehicleParameters;

const P: f64 = 0.35;

fn closed_loop(law: Law, speed: f64, deviation: f64) -> Option<ClosedLoop> {
    ClosedLoop::new(VehicleParameters::paper(), law, P, speed, deviation).ok()
}

/// 80 speeds by 121 deviations.
fn eigenvalue_map(law: Law) -> f64 {
    let mut sum = 0.0;
    for speed in 1..=80 {
        for deviation in -60..=60 {
            let at = closed_loop(law, f64::from(speed) * 0.1, f64::from(deviation) * 0.01);
            let eigenvalues = at.map(|at| at.eigenvalues()).unwrap_or_default();
            sum += eigenvalues.last().map_or(0.0, |value| value.re);
        }
    }
    sum
}

/// 159 speeds, with frequencies and Lyapunov coefficients.
fn hopf_curve(law: Law) -> f64 {
    let vehicle = VehicleParameters::paper();
    let mut sum = 0.0;
    for speed in 2..=160 {
        let speed = f64::from(speed) * 0.05;
        let points = hopf_points(vehicle, law, Belief::CentreOfMass, P, speed).unwrap_or_default();
        sum += points
            .iter()
            .map(|point| point.lyapunov.kuznetsov)
            .sum::<f64>();
    }
    sum
}

fn margins() -> Option<f64> {
    let sampled = SampledLoop::new(
        closed_loop(Law::FrontPoint, 2.0, 0.0)?,
        Timing::new(0.01, 0.01),
    )
    .ok()?;
    let limits = MarginLimits::default();
    Some(sampled.delay_margin(limits)? + sampled.longest_constant_interval(limits)?)
}

fn stability(criterion: &mut Criterion) {
    for (name, law) in [
        ("front-point", Law::FrontPoint),
        ("velocity-point", Law::VelocityPoint),
    ] {
        criterion.bench_function(&format!("eigenvalue map 80 x 121, {name}"), |bencher| {
            bencher.iter(|| eigenvalue_map(black_box(law)));
        });
        criterion.bench_function(&format!("Hopf curve 159, {name}"), |bencher| {
            bencher.iter(|| hopf_curve(black_box(law)));
        });
    }
    criterion.bench_function(
        "delay margin and longest constant marker interval at 2 m/s",
        |bencher| {
            bencher.iter(margins);
        },
    );
}

criterion_group!(benches, stability);
criterion_main!(benches);
