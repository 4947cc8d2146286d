//! Losses of poses, sensors and board, late ticks, and the stops that they lead to, by the pilot on an
//! ideal car.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_control::{Circle, Position, Reference, Velocity, VelocityStep, VelocitySteps};
use singletrack_pilot::{
    Arming, BoardRequest, BoardState, Event, LinkState, Mode, PilotConfig, PilotRequest, Reason,
};

use crate::bench::{AT_START, Bench, Pose, config};

#[test]
fn the_car_drives_through_a_short_marker_loss_with_the_last_pose() {
    let mut bench = Bench::new();
    bench.drive();
    bench.pose = Pose::Missing;
    let mut held = None;
    for tick in 0..20 {
        let output = bench.step();
        assert_eq!(output.mode, Mode::Driving);
        assert!(output.held);
        let estimate = output.estimate.unwrap();
        if tick > 3 {
            let pose = (estimate.position, estimate.yaw);
            assert_eq!(*held.get_or_insert(pose), pose, "the pose is held");
        }
    }
    bench.pose = Pose::Seen;
    let output = bench.step();
    assert!(!output.held);
    assert!((output.estimate.unwrap().position - bench.position).norm() < 0.02);
}

#[test]
fn a_long_marker_loss_ends_in_a_stop_with_a_reason() {
    let mut bench = Bench::new();
    bench.drive();
    bench.pose = Pose::Missing;
    let (output, seconds) = bench.run_until_idle();
    assert_eq!(output.reason, Some(Reason::PoseTooOld));
    // Hold, then ramp: 0.3 s, and 0.5 m/s at 1.5 m/s².
    assert!(seconds < 0.9, "{seconds} s");
    // The reason stays when the markers are back, until the next drive.
    bench.pose = Pose::Seen;
    let output = bench.run(100);
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Ready, Some(Reason::PoseTooOld))
    );
}

#[test]
fn the_reason_of_a_stop_stays_until_the_next_drive() {
    let mut bench = Bench::new();
    bench.drive();
    bench.step_with(Some(PilotRequest::Disarm));
    let (output, _) = bench.run_until_idle();
    assert_eq!(output.reason, Some(Reason::Requested));
    let output = bench.run(50);
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Ready, Some(Reason::Requested))
    );
    assert_eq!(bench.pilot.reason(), Some(Reason::Requested));
    bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    let output = bench.run(3);
    assert_eq!((output.mode, output.reason), (Mode::Driving, None));
}

#[test]
fn the_end_of_the_reference_ends_the_drive() {
    let mut bench = Bench::new();
    bench.drive();
    let (output, _) = bench.run_until_idle();
    assert_eq!(output.reason, Some(Reason::ReferenceFinished));
}

#[test]
fn a_silent_imu_ends_the_drive() {
    let mut bench = Bench::new();
    bench.drive();
    bench.imu = false;
    let (output, seconds) = bench.run_until_idle();
    assert_eq!(output.reason, Some(Reason::ImuSilent));
    assert!(seconds < 0.6);
}

#[test]
fn poses_that_gyro_and_speed_cannot_explain_are_rejected_and_end_the_drive() {
    let mut bench = Bench::new();
    bench.drive();
    let before = bench.step().estimate.unwrap();
    bench.pose = Pose::Jumped;
    let after = bench.step().estimate.unwrap();
    assert!(
        (after.position - before.position).norm() < 0.02,
        "one jump does not move the estimate"
    );
    let (output, seconds) = bench.run_until_idle();
    assert_eq!(output.reason, Some(Reason::PoseImplausible));
    assert!(seconds < 0.7);
}

#[test]
fn a_lost_link_ends_the_drive_at_once_and_its_return_does_not_start_it() {
    let mut bench = Bench::new();
    bench.drive();
    bench.tick += 1;
    let output = bench
        .pilot
        .step(bench.now(), &[Event::Link(LinkState::Down)]);
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Disconnected, Some(Reason::LinkDown))
    );
    assert!(output.command.is_none());
    bench.speed = 0.0;
    bench.board = BoardState::Neutral;
    bench.tick += 1;
    bench.pilot.step(bench.now(), &AT_START);
    for _ in 0..300 {
        let output = bench.step();
        assert!(output.command.is_none() && output.request.is_none());
    }
}

#[test]
fn a_car_that_loses_board_and_cameras_has_no_speed_and_its_stop_no_deceleration() {
    // With the last sample of a car that slows down, and of one that drives evenly.
    for slows_down in [true, false] {
        let mut bench = Bench::new();
        bench.drive();
        if slows_down {
            bench.step_with(Some(PilotRequest::Disarm));
            bench.run(8);
        }
        (bench.link, bench.pose) = (false, Pose::Missing);
        bench.extra.push(Event::Link(LinkState::Down));
        for tick in 1..=2_000 {
            let output = bench.step();
            assert_eq!(output.mode, Mode::Disconnected);
            assert_eq!(output.braking_measured, None, "{tick}");
            // The motor's last speed counts for 0.2 s, the last pose for 0.3 s.
            let known = output.estimate.is_some();
            assert_eq!(known, tick <= 30, "{tick}: {:?}", output.estimate);
            assert_eq!(known, output.point.is_some(), "{tick}");
        }
        (bench.link, bench.pose, bench.board) = (true, Pose::Seen, BoardState::Neutral);
        bench.speed = 0.0;
        bench.extra.extend(AT_START);
        let output = bench.run(200);
        assert_eq!(output.preflight, None);
        assert_eq!(
            bench
                .step_with(Some(PilotRequest::Arm(Arming::Unattended)))
                .mode,
            Mode::Arming
        );
    }
}

#[test]
fn a_car_without_cameras_has_the_speed_of_its_motor() {
    let mut bench = Bench::new();
    bench.run(100);
    bench.pose = Pose::Missing;
    let estimate = bench.run(600).estimate.unwrap();
    assert!(estimate.speed.abs() < 0.01 && estimate.pose_age() > 5.9);
}

#[test]
fn a_lower_belief_of_the_brakes_clears_the_refusal_whatever_was_measured() {
    let mut bench = Bench::new();
    bench.drive();
    bench.step_with(Some(PilotRequest::Disarm));
    // It rolls on and on, at a speed that is too low for a fault.
    let mut measured = None;
    for _ in 0..3_000 {
        measured = measured.or(bench.step().braking_measured);
        bench.speed = bench.speed.max(0.07);
    }
    let measured = measured.unwrap();
    assert!(measured < 0.9, "{measured}");
    bench.speed = 0.0;
    let refused = bench.run(100).preflight;
    assert_eq!(
        refused,
        Some(Reason::BrakesLessThanConfigured),
        "{measured}"
    );
    for (braking, refused) in [(1.4, refused), (measured, None), (0.05, None)] {
        let config = PilotConfig {
            braking,
            ..config()
        };
        bench.pilot.reconfigure(&config).unwrap();
        assert_eq!(bench.run(100).preflight, refused, "{braking}");
    }
}

#[test]
fn a_board_that_stops_by_itself_ends_the_drive_and_is_not_armed_again() {
    let mut bench = Bench::new();
    bench.drive();
    bench.board = BoardState::Failsafe;
    let output = bench.step();
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Idle, Some(Reason::BoardFailsafe))
    );
    bench.speed = 0.0;
    for _ in 0..300 {
        let output = bench.step();
        assert!(output.command.is_none() && output.request.is_none());
    }
}

#[test]
fn an_emergency_stop_while_driving_goes_to_the_board_and_latches() {
    let mut bench = Bench::new();
    bench.drive();
    let output = bench.step_with(Some(PilotRequest::EmergencyStop));
    assert_eq!(output.request, Some(BoardRequest::EmergencyStop));
    assert!(output.command.is_none());
    assert_eq!(output.mode, Mode::Fault);
    let output = bench.step_with(Some(PilotRequest::Disarm));
    assert_eq!(output.mode, Mode::Fault, "the board is still stopped");
    for _ in 0..100 {
        assert!(
            bench
                .step_with(Some(PilotRequest::Arm(Arming::Unattended)))
                .command
                .is_none()
        );
    }
}

#[test]
fn a_car_without_poses_slows_down_and_drives_on_when_poses_return() {
    let mut bench = Bench::new();
    bench.drive();
    bench.pose = Pose::Missing;
    let mut speeds = Vec::new();
    let slowing = loop {
        let output = bench.step();
        speeds.push(bench.speed);
        if output.mode == Mode::Slowing && bench.speed < 0.4 {
            break output;
        }
        assert!(speeds.len() < 60);
    };
    assert_eq!(slowing.reason, Some(Reason::PoseTooOld));
    assert!(slowing.drive_time.is_some() && slowing.command.is_some());
    let steering = bench.steering;
    bench.step();
    assert_eq!(bench.steering, steering, "the steering is held");
    bench.pose = Pose::Seen;
    assert_eq!(bench.run(2).mode, Mode::Slowing);
    let output = bench.step();
    assert_eq!((output.mode, output.reason), (Mode::Driving, None));
    // The speed does not jump: it rises with the largest acceleration.
    let before = bench.speed;
    bench.step();
    assert!(bench.speed > before && bench.speed <= before + 0.0201);
    // The time of the reference has gone on.
    assert!(output.drive_time > slowing.drive_time);
}

#[test]
fn a_blind_car_does_not_speed_up() {
    let mut bench = Bench::new();
    bench.run(100);
    bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    bench.run(12);
    bench.pose = Pose::Missing;
    bench.run(6);
    let speed = bench.speed;
    assert!(speed > 0.1 && speed < 0.4, "{speed}");
    for _ in 0..20 {
        assert_eq!(bench.step().mode, Mode::Driving);
        // That of the rear axle: the sideslip is still estimated.
        assert!(bench.speed <= speed + 1e-5, "{} of {speed}", bench.speed);
    }
    bench.pose = Pose::Seen;
    bench.run(2);
    assert!(bench.speed > speed);
}

#[test]
fn a_fast_car_holds_a_pose_for_a_shorter_time() {
    let held_for = |velocity: f64| {
        let mut bench = Bench::with(PilotConfig {
            reference: Reference::VelocitySteps(
                VelocitySteps::new(&[VelocityStep {
                    duration: 30.0,
                    velocity: Velocity::new(velocity, 0.0),
                }])
                .unwrap(),
            ),
            ..config()
        });
        bench.drive();
        bench.pose = Pose::Missing;
        (0..100)
            .take_while(|_| bench.step().mode == Mode::Driving)
            .count()
    };
    // 0.15 m at 1.5 m/s are 0.1 s; at 0.4 m/s the limit of 0.3 s comes first.
    assert!((9..=11).contains(&held_for(1.5)), "{}", held_for(1.5));
    assert!((28..=30).contains(&held_for(0.4)), "{}", held_for(0.4));
}

#[test]
fn motor_pulses_that_count_double_end_the_drive() {
    let mut bench = Bench::new();
    bench.drive();
    bench.pulses = 2.0;
    let (output, _) = bench.run_until_idle();
    assert_eq!(output.reason, Some(Reason::MotorSpeedMismatch));
}

#[test]
fn a_stop_measures_by_the_slower_of_motor_and_cameras_if_they_contradict_each_other() {
    // The bench brakes with 1.5 m/s² on its ramp, as configured, if the cameras are right.
    for (pulses, least, most, refused) in [
        (1.0, 1.4, 1.75, None),
        (2.0, 1.4, 1.75, None),
        (0.45, 0.63, 0.8, Some(Reason::BrakesLessThanConfigured)),
        // No motor sensor.
        (0.0, 1.4, 1.75, None),
    ] {
        let mut bench = Bench::new();
        bench.drive();
        bench.pulses = pulses;
        if pulses == 1.0 {
            bench.step_with(Some(PilotRequest::Disarm));
        }
        let measured = (0..300).find_map(|_| bench.step().braking_measured);
        assert!(
            measured.is_some_and(|measured| (least..most).contains(&measured)),
            "{pulses}: {measured:?}"
        );
        bench.pulses = 1.0;
        bench.run(100);
        bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
        let output = bench.run(2);
        assert_eq!(output.reason, refused, "{pulses}");
        assert_eq!(output.mode.is_underway(), refused.is_none(), "{pulses}");
    }
}

#[test]
fn an_imu_that_hangs_or_is_biased_ends_the_drive() {
    for (bias, noisy, reason) in [
        (0.0, false, Reason::ImuStuck),
        (12.0, true, Reason::ImuImplausible),
    ] {
        let mut bench = Bench::new();
        bench.drive();
        bench.gyro_bias = bias;
        bench.noisy = noisy;
        if !noisy {
            // The last measurement, repeated.
            bench.stuck = Some(0.1);
        }
        let (output, seconds) = bench.run_until_idle();
        assert_eq!(output.reason, Some(reason));
        assert!(seconds < 1.0, "{seconds}");
    }
}

#[test]
fn a_reversed_gyro_ends_the_drive_of_a_proved_car_until_a_person_has_looked() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::Circle(Circle::new(Position::new(0.0, 1.0), 1.0, 1.0).unwrap()),
        ..config()
    });
    // On the circle, less the distance of P before the centre of mass.
    bench.position = Position::new(-0.35, 0.0);
    bench.gyro_gain = -1.0;
    assert_eq!(bench.run(100).mode, Mode::Ready);
    bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    let (output, _) = bench.run_until_idle();
    assert_eq!(output.reason, Some(Reason::GyroDiffers));
    let turned = bench.yaw.abs();
    assert!((0.06..0.3).contains(&turned), "{turned} rad");
    bench.run(100);
    bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    assert_ne!(bench.run(5).mode, Mode::Driving);
}

#[test]
fn the_next_drive_waits_until_the_last_stop_is_measured() {
    let mut bench = Bench::new();
    bench.drive();
    bench.step_with(Some(PilotRequest::Disarm));
    let (mut output, _) = bench.run_until_idle();
    let mut refused = 0;
    let mut words = Vec::new();
    while output.braking_measured.is_none() {
        words.extend(output.preflight);
        output = bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
        assert_ne!(output.mode, Mode::Arming, "before the stop was measured");
        refused += 1;
        assert!(refused < 100, "never measured");
    }
    assert!(refused > 5, "{refused}");
    assert_eq!(words.last(), Some(&Reason::Moving));
    bench.step();
    assert_eq!(
        bench
            .step_with(Some(PilotRequest::Arm(Arming::Unattended)))
            .mode,
        Mode::Arming
    );
}

#[test]
fn a_tick_that_comes_too_late_ends_the_drive() {
    let mut bench = Bench::new();
    bench.drive();
    bench.tick += 8;
    let output = bench.step();
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Stopping, Some(Reason::DeadlineMissed))
    );
}
