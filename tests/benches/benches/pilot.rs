//! Cost of a control tick: one pose and one board record in, one command out, with every outer
//! loop, with the compensation of the actuators, and with corrections that were learned. The ideal car of the tests is driven.

#[path = "../../../host/pilot/tests/bench/mod.rs"]
mod bench;
mod ticks;

use bench::{Bench, config};
use criterion::{Criterion, criterion_group, criterion_main};
use singletrack_control::{
    ActuatorModel, Circle, DelayedMpc, FrontPointLaw, LqiAxis, LqiConfig, LqiLoop, Motion,
    MpcConfig, Position, Reference, TrackingLoop, Velocity,
};
use singletrack_pilot::{Compensation, Event, Learned, Mode, PilotConfig};
use ticks::measure;

const PERIOD: f64 = 0.01;

fn lqi() -> Option<TrackingLoop> {
    let axis = LqiAxis {
        lag: 0.0,
        integral_weight: 1.0,
        error_weight: 1.0,
        velocity_weight: 0.0625,
    };
    let config = LqiConfig {
        along: axis,
        across: axis,
        integral_limit: 0.3,
        turn_rate: 1.0,
        period: PERIOD,
    };
    LqiLoop::new(config).ok().map(TrackingLoop::Lqi)
}

fn mpc() -> Option<TrackingLoop> {
    let config = MpcConfig {
        lag: 0.0,
        period: PERIOD,
        ticks_per_stage: 3,
        position_weight: 1.0,
        velocity_weight: 0.02,
        acceleration_weight: 0.004,
        max_speed: 1.5,
        max_acceleration: 2.8,
        max_deceleration: 2.0,
        area: None,
        iterations: 20,
        disturbance_gain: 0.02,
    };
    DelayedMpc::new(config, 0.0).ok().map(TrackingLoop::Mpc)
}

/// A drive along a circle that goes on for as long as it is measured.
fn drive(config: PilotConfig) -> Option<Bench> {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::Circle(Circle::new(Position::new(0.48, 1.5), 1.5, 0.4).ok()?),
        ..config
    });
    bench.drive();
    Some(bench)
}

fn control_tick(criterion: &mut Criterion) {
    let off = config().compensation;
    let on = Compensation {
        actuation: Some(ActuatorModel {
            steering_dead_time: 0.018,
            steering_lag: 0.04,
            speed_dead_time: 0.036,
            speed_lag: 0.08,
        }),
        ..off
    };
    for (name, tracking) in [
        ("pilot, proportional", Some(config().tracking)),
        ("pilot, lqi", lqi()),
        ("pilot, mpc", mpc()),
    ] {
        for (compensates, compensation) in [("", off), (", compensated", on)] {
            let driven = tracking.clone().and_then(|tracking| {
                drive(PilotConfig {
                    tracking,
                    compensation,
                    ..config()
                })
            });
            let Some(mut bench) = driven else { continue };
            measure(criterion, &format!("{name}{compensates}"), || {
                let output = bench.step();
                assert_eq!(output.mode, Mode::Driving, "{:?}", output.reason);
            });
        }
    }
}

/// A drive of which the cameras have shown something.
fn learning_tick(criterion: &mut Criterion) {
    let Some(mut bench) = drive(PilotConfig {
        learns: true,
        ..config()
    }) else {
        return;
    };
    bench.extra.push(Event::Learned(Learned {
        steering_trim: 0.002,
        stamp_offset: 0.002,
        body_yaw: 0.002,
        pivot_left: 0.001,
        ..Learned::default()
    }));
    bench.run(200);
    assert_ne!(bench.pilot.learned(), Some(Learned::default()));
    measure(criterion, "pilot, proportional, live", || {
        let output = bench.step();
        assert_eq!(output.mode, Mode::Driving, "{:?}", output.reason);
    });
}

fn law_alone(criterion: &mut Criterion) {
    let Ok(law) = FrontPointLaw::new(0.1368, 0.35, 0.26) else {
        return;
    };
    let motion = Motion {
        yaw: 0.3,
        yaw_rate: 0.5,
        sideslip: 0.15,
    };
    criterion.bench_function("front-point law", |bencher| {
        bencher.iter(|| {
            law.command(
                std::hint::black_box(&motion),
                0.33,
                std::hint::black_box(&Velocity::new(0.3, 0.2)),
            )
        });
    });
}

criterion_group!(benches, control_tick, learning_tick, law_alone);
criterion_main!(benches);
