//! Outer loops with a state in the pilot: what of it lasts, and what does not.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use crate::bench::{Bench, Pose, config};
use singletrack_control::{
    Circle, DelayedMpc, LqiAxis, LqiConfig, LqiLoop, MpcConfig, OuterLoop as _, Position,
    Reference, TrackingInput, TrackingLoop, Velocity,
};
use singletrack_pilot::{Arming, Mode, Output, PilotConfig, PilotRequest};

const PERIOD: f64 = 0.01;

fn lqi() -> TrackingLoop {
    let axis = LqiAxis {
        lag: 0.0,
        integral_weight: 3.0,
        error_weight: 1.0,
        velocity_weight: 0.03,
    };
    let config = LqiConfig {
        along: axis,
        across: axis,
        integral_limit: 0.3,
        turn_rate: 1.0,
        period: PERIOD,
    };
    TrackingLoop::Lqi(LqiLoop::new(config).unwrap())
}

fn mpc() -> TrackingLoop {
    let config = MpcConfig {
        lag: 0.0,
        period: PERIOD,
        ticks_per_stage: 3,
        position_weight: 1.0,
        velocity_weight: 0.03,
        acceleration_weight: 0.001,
        max_speed: 1.5,
        max_acceleration: 2.8,
        max_deceleration: 2.0,
        area: None,
        iterations: 20,
        disturbance_gain: 0.05,
    };
    TrackingLoop::Mpc(DelayedMpc::new(config, 0.0).unwrap())
}

/// A circle on which P of the bench's car begins a drive.
fn circle() -> Reference {
    Reference::Circle(Circle::new(Position::new(0.48, 1.5), 1.5, 0.3).unwrap())
}

fn pilot(tracking: TrackingLoop) -> PilotConfig {
    PilotConfig {
        tracking,
        reference: circle(),
        ..config()
    }
}

/// What a loop without a past answers in this tick of a car that has stood.
fn first_answer(tracking: &TrackingLoop, output: &Output) -> Velocity {
    let time = output.drive_time.unwrap();
    tracking.clone().step(&TrackingInput {
        point: output.point.unwrap(),
        reference: &|ahead| circle().at(time + ahead),
        applied: Velocity::zeros(),
        period: PERIOD,
    })
}

/// Arms; the first tick of the drive.
fn begin(bench: &mut Bench) -> Output {
    assert_eq!(bench.run(100).mode, Mode::Ready);
    bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    for _ in 0..10 {
        let output = bench.step();
        if output.mode == Mode::Driving {
            return output;
        }
    }
    panic!("it never drove");
}

#[test]
fn the_next_drive_knows_nothing_of_the_last_one() {
    for tracking in [lqi(), mpc()] {
        let mut bench = Bench::with(pilot(tracking.clone()));
        for _ in 0..2 {
            let output = begin(&mut bench);
            let answer = first_answer(&tracking, &output);
            assert_eq!(output.point_velocity, Some(answer), "{output:?}");
            let output = bench.run(300);
            let answer = first_answer(&tracking, &output);
            assert_ne!(output.point_velocity, Some(answer), "it has a past by now");
            bench.step_with(Some(PilotRequest::Disarm));
            bench.run_until_idle();
            bench.run(200);
        }
    }
}

#[test]
fn a_drive_that_goes_on_after_slowing_begins_to_follow_anew() {
    for tracking in [lqi(), mpc()] {
        let mut bench = Bench::with(pilot(tracking));
        begin(&mut bench);
        bench.run(200);
        bench.pose = Pose::Missing;
        let mut slowed = false;
        for _ in 0..60 {
            slowed |= bench.step().mode == Mode::Slowing;
        }
        assert!(slowed);
        bench.pose = Pose::Seen;
        for _ in 0..200 {
            let output = bench.step();
            if let Some(wanted) = output.point_velocity {
                assert!(wanted.norm() < 5.0, "{wanted}");
            }
        }
    }
}
