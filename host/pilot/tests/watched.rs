//! What the watches find, seen from outside.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_control::{PoseSample, Velocity};
use singletrack_pilot::{
    Arming, BoardHealth, BoardState, Event, Jog, LinkState, Mode, Output, PilotRequest, Reason,
};

use crate::bench::{Bench, Pose};

#[test]
fn poses_that_repeat_to_the_bit_for_a_third_of_a_second_end_the_drive() {
    let mut bench = Bench::new();
    bench.drive();
    let frozen = (bench.position, bench.yaw);
    bench.pose = Pose::Missing;
    let begin = bench.tick;
    loop {
        bench.extra.push(Event::Pose(PoseSample {
            capture: bench.now(),
            receive: bench.now(),
            frame: i32::try_from(bench.tick).unwrap(),
            position: frozen.0,
            yaw: frozen.1,
        }));
        let output = bench.step();
        let ticks = bench.tick - begin;
        if output.mode == Mode::Stopping {
            assert_eq!(output.reason, Some(Reason::PoseFrozen));
            assert!((29..=33).contains(&ticks), "{ticks}");
            return;
        }
        assert!(ticks < 100);
    }
}

/// The reason after cameras have drifted sideways (m/s) during a drive until it ended, or after it,
/// and go on for three seconds.
fn drifting(in_the_drive: bool) -> (Reason, Option<Reason>) {
    let mut bench = Bench::new();
    bench.drive();
    let drift = Velocity::new(0.0, 0.002);
    if !in_the_drive {
        bench.step_with(Some(PilotRequest::Disarm));
    }
    let mut ended = None;
    for _ in 0..600 {
        if in_the_drive || ended.is_some() {
            bench.position += drift;
        }
        let output = bench.step();
        if !matches!(output.mode, Mode::Driving | Mode::Slowing) && ended.is_none() {
            ended = output.reason;
        }
        if output.reason == Some(Reason::StopNotObeyed) {
            return (ended.unwrap(), output.reason);
        }
    }
    (ended.unwrap(), None)
}

#[test]
fn cameras_that_drift_after_they_ended_the_drive_are_believed_less_than_wheels_that_stand() {
    let (ended, after) = drifting(true);
    assert!(
        matches!(
            ended,
            Reason::PoseImplausible
                | Reason::BodyYawWrong
                | Reason::SideslipImplausible
                | Reason::EstimateInconsistent
        ),
        "{ended}"
    );
    assert_eq!(after, None);
    let (ended, after) = drifting(false);
    assert_eq!(ended, Reason::Requested);
    assert_eq!(after, Some(Reason::StopNotObeyed));
}

#[test]
fn pulses_that_were_given_before_the_board_was_armed_are_not_sent() {
    let jog = Jog {
        servo_us: 1_500,
        esc_us: 1_560,
    };
    let mut bench = Bench::new();
    bench.run(100);
    let mut jogged = Vec::new();
    for tick in 0..8 {
        // Only until the tick that sees the board armed.
        if tick <= 3 {
            bench.extra.push(Event::Jog(jog));
        }
        if tick == 3 {
            bench.board = BoardState::Armed;
        }
        let output = bench.step_with((tick == 0).then_some(PilotRequest::Arm(Arming::Jog)));
        if tick < 3 {
            bench.board = BoardState::Neutral;
        }
        jogged.push((output.mode, output.jog));
    }
    assert!(jogged.iter().any(|(mode, _)| *mode == Mode::Jogging));
    assert!(jogged.iter().all(|(_, jog)| jog.is_none()), "{jogged:?}");

    bench.extra.push(Event::Jog(jog));
    assert_eq!(bench.step().jog, Some(jog));
}

#[test]
fn a_board_without_its_configuration_does_not_say_that_the_wheels_stand() {
    let mut bench = Bench::new();
    bench.drive();
    // It restarted, and takes no configuration: its motor speed is 0 from here on. The throttle is
    // stuck.
    bench.pulses = 0.0;
    bench
        .extra
        .push(Event::Link(LinkState::ConfigurationRefused));
    let fault = (Mode::Fault, Some(Reason::StopNotObeyed));
    for _ in 0..200 {
        bench.position += Velocity::new(0.005, 0.001);
        bench.step();
    }
    let output = bench.step();
    assert_eq!((output.mode, output.reason), fault);
    bench.pose = Pose::Missing;
    for _ in 0..100 {
        bench.step();
    }
    let output = bench.step_with(Some(PilotRequest::Disarm));
    assert_eq!((output.mode, output.reason), fault);

    bench.extra.push(Event::Link(LinkState::Ready));
    bench.step();
    bench.step();
    let output = bench.step_with(Some(PilotRequest::Disarm));
    assert_ne!(output.mode, Mode::Fault);
}

#[test]
fn a_board_without_its_configuration_does_not_lead_the_estimate_away_while_markers_are_lost() {
    let mut bench = Bench::new();
    bench.drive();
    let (speed, steering) = (bench.speed, bench.steering);
    bench.pulses = 0.0;
    bench
        .extra
        .push(Event::Link(LinkState::ConfigurationRefused));
    for tick in 0..200 {
        bench.pose = if (20..80).contains(&tick) {
            Pose::Missing
        } else {
            Pose::Seen
        };
        // The throttle is stuck.
        (bench.speed, bench.speed_before) = (speed, speed);
        bench.steering = steering;
        let output = bench.step();
        assert_eq!(output.held, bench.pose == Pose::Missing, "{tick}");
        let estimated = output.estimate.unwrap().speed;
        assert!((estimated - speed).abs() < 0.05, "{tick}: {estimated}");
    }
}

#[test]
fn a_motor_sensor_that_dies_in_a_stop_does_not_say_that_a_car_before_rare_cameras_stands() {
    let mut bench = Bench::new();
    bench.drive();
    let (speed, steering) = (bench.speed, bench.steering);
    bench.step_with(Some(PilotRequest::Disarm));
    bench.pulses = 0.0;
    for tick in 0..200 {
        bench.pose = if tick % 11 == 0 {
            Pose::Seen
        } else {
            Pose::Missing
        };
        // The throttle is stuck.
        (bench.speed, bench.speed_before) = (speed, speed);
        bench.steering = steering;
        let output = bench.step();
        if output.reason == Some(Reason::StopNotObeyed) {
            assert!(tick < 100, "{tick}");
            return;
        }
    }
    panic!("nothing was found");
}

/// The yaw rates that a wrong bit of a sample makes (mrad/s in 16 bits): the two highest bits.
const WRONG_BITS: [f64; 4] = [-32.768, 32.768, -16.384, 16.384];

#[test]
fn one_impossible_sample_of_the_imu_changes_nothing_of_a_drive() {
    for wrong in WRONG_BITS {
        let [mut bench, mut clean] = [Bench::new(), Bench::new()];
        bench.drive();
        clean.drive();
        for tick in 0..300 {
            bench.gyro_bias = if tick == 0 { wrong } else { 0.0 };
            let [output, expected] = [bench.step(), clean.step()];
            assert_eq!(output.mode, Mode::Driving, "{wrong}: {:?}", output.reason);
            let yaw = |output: &Output| output.estimate.unwrap().yaw;
            let off = yaw(&output) - yaw(&expected);
            assert!(off.abs() < 2e-3, "{wrong}: {off} rad at {tick}");
        }
    }
}

#[test]
fn one_impossible_sample_of_the_imu_at_rest_does_not_refuse_to_arm() {
    for wrong in WRONG_BITS {
        let mut bench = Bench::new();
        assert_eq!(bench.run(100).mode, Mode::Ready);
        for tick in 0..300 {
            bench.gyro_bias = if tick == 0 { wrong } else { 0.0 };
            let output = bench.step();
            assert_eq!(output.mode, Mode::Ready, "{wrong}: {:?}", output.reason);
        }
    }
}

#[test]
fn impossible_samples_without_end_are_implausible_and_not_silence() {
    let mut bench = Bench::new();
    bench.drive();
    bench.gyro_bias = 20.0;
    let ends = (1..).find(|_| bench.step().mode == Mode::Stopping);
    assert_eq!(ends, Some(5));
    let output = bench.run(100);
    assert_eq!(output.reason, Some(Reason::ImuImplausible));
    bench.run_until_idle();
    assert_eq!(bench.run(100).preflight, Some(Reason::ImuImplausible));
}

#[test]
fn an_error_of_the_imu_that_is_reported_once_refuses_to_arm_and_ends_no_drive() {
    let fault = Event::Health(BoardHealth {
        imu_fault: true,
        battery_mv: 7_400,
        stop_input_open: false,
        battery_open: false,
    });
    let mut bench = Bench::new();
    bench.run(100);
    bench.extra.push(fault);
    assert_eq!(bench.step().reason, Some(Reason::ImuFault));
    assert_eq!(bench.run(20).mode, Mode::Ready);
    bench.drive();
    bench.extra.push(fault);
    assert_eq!(bench.run(20).mode, Mode::Driving);
    bench.extra.extend([fault; 2]);
    let output = bench.step();
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Stopping, Some(Reason::ImuFault))
    );
}
