//! Cost of a control tick: one pose and one board record in, one command out, with every outer
//! loop, with the compensation of the actuators, and with what is learned. The ideal car of the
//! tests is driven.

#![allow(clippy::disallowed_methods, reason = "a benchmark repeats no bits")]

#[path = "../../../host/pilot/tests/bench/mod.rs"]
mod bench;
mod ticks;

use bench::{Bench, config};
use criterion::{Criterion, criterion_group, criterion_main};
use singletrack_control::{
    ActuatorModel, Calibration, CalibrationConfig, Circle, DelayedMpc, FrontPointLaw,
    InertialSample, LqiAxis, LqiConfig, LqiLoop, Motion, MpcConfig, PoseSample, Position,
    Reference, Time, TrackingLoop, VehicleParameters, Velocity,
};
use singletrack_pilot::{Compensation, Event, Learned, Mode, PilotConfig};
use ticks::measure;

const PERIOD: f64 = 0.01;

const ACTUATORS: ActuatorModel = ActuatorModel {
    steering_dead_time: 0.018,
    steering_lag: 0.04,
    speed_dead_time: 0.036,
    speed_lag: 0.08,
};

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
        actuation: Some(ACTUATORS),
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

/// The tick that learns: the pilot's with `mode = "live"`, which is told something once a second;
/// and what `advice` and `live` add to it on the thread of the log, a tick and the estimates of
/// once a second.
fn learning(criterion: &mut Criterion) {
    let live = PilotConfig {
        learns: true,
        ..config()
    };
    let Some(mut bench) = drive(live) else { return };
    let learned = Learned {
        steering_gain: -0.2,
        ..Learned::default()
    };
    measure(criterion, "pilot, proportional, live", || {
        if bench.tick.is_multiple_of(100) {
            bench.extra.push(Event::Learned(learned));
        }
        let output = bench.step();
        assert_eq!(output.mode, Mode::Driving, "{:?}", output.reason);
    });
    let mut calibration = Calibration::new(CalibrationConfig {
        vehicle: VehicleParameters::paper(),
        actuators: ACTUATORS,
        marker_offset: [0.0; 2],
        marker_yaw: 0.0,
        pulse_distance: 0.003,
    });
    let mut tick = 0_u64;
    let mut learn = |calibration: &mut Calibration| {
        tick += 1;
        let time = Time(tick * 10_000_000);
        let yaw = 0.5 * (0.01 * tick as f64).sin();
        calibration.begin_tick(time);
        calibration.pose(&PoseSample {
            capture: time,
            receive: time,
            frame: 0,
            position: Position::new(0.01 * tick as f64, yaw),
            yaw,
        });
        let inertial = InertialSample {
            time,
            yaw_rate: yaw,
            forward_acceleration: 0.0,
            left_acceleration: 0.0,
        };
        calibration.board(time, Some(inertial), 1.0);
        calibration.end_tick(time, Some(0.2 * yaw));
    };
    // The memory is full.
    (0..36_000).for_each(|_| learn(&mut calibration));
    measure(criterion, "calibration, tick", || learn(&mut calibration));
    measure(criterion, "calibration, estimates", || {
        calibration.estimates()
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

criterion_group!(benches, control_tick, learning, law_alone);
criterion_main!(benches);
