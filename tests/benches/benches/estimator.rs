//! Cost of a step of the estimator alone: an inertial sample, a pose, and the estimate for now.
//!
//! It allocates nothing: its crate is `no_std` without `alloc`, and `tests/real_time.rs` of the
//! daemon counts the allocations of the ticks around it.

#![allow(clippy::disallowed_methods, reason = "a benchmark repeats no bits")]

mod ticks;

use criterion::{Criterion, criterion_group, criterion_main};
use singletrack_control::{
    Estimate, Estimator, EstimatorConfig, InertialSample, PoseSample, PoseVerdict, Position, Time,
    VehicleParameters,
};

use ticks::measure;

const PERIOD_NS: u64 = 10_000_000;
/// Age of a pose when it arrives.
const LATENCY_NS: u64 = 5_000_000;
const RADIUS: f64 = 1.5;
const SPEED: f64 = 1.0;

/// A car on a circle, seen without noise.
struct Circle {
    estimator: Estimator,
    time: Time,
    rear_axle_distance: f64,
}

impl Circle {
    fn new() -> Self {
        let config = EstimatorConfig::for_vehicle(&VehicleParameters::paper());
        Self {
            estimator: Estimator::new(config),
            time: Time(PERIOD_NS),
            rear_axle_distance: config.rear_axle_distance,
        }
    }

    // By its own name in the profile of callgrind, which counts instructions.
    #[inline(never)]
    fn step(&mut self) -> (PoseVerdict, Option<Estimate>) {
        self.time = Time(self.time.0 + PERIOD_NS);
        let capture = Time(self.time.0 - LATENCY_NS);
        let yaw_rate = SPEED / RADIUS;
        let yaw = yaw_rate * capture.0 as f64 * 1e-9;
        let inertial = InertialSample {
            time: Time(capture.0 + LATENCY_NS / 2),
            yaw_rate,
            forward_acceleration: -self.rear_axle_distance * yaw_rate * yaw_rate,
            left_acceleration: SPEED * yaw_rate,
        };
        self.estimator.handle_inertial(inertial, Some(SPEED));
        // The rear axle moves along the car.
        let ahead = self.rear_axle_distance;
        let pose = PoseSample {
            capture,
            receive: self.time,
            frame: 0,
            position: Position::new(
                RADIUS * yaw.sin() + ahead * yaw.cos(),
                -RADIUS * yaw.cos() + ahead * yaw.sin(),
            ),
            yaw,
        };
        let verdict = self.estimator.handle_pose(&pose);
        self.estimator.send(self.time, 0.17);
        (verdict, self.estimator.estimate(self.time))
    }
}

fn estimator_step(criterion: &mut Criterion) {
    let mut circle = Circle::new();
    measure(criterion, "estimator step", || {
        let (verdict, estimate) = circle.step();
        assert_eq!(verdict, PoseVerdict::Accepted);
        estimate
    });
}

criterion_group!(benches, estimator_step);
criterion_main!(benches);
