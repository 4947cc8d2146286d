//! The pilot on an ideal car that follows every command exactly: modes, reasons, and
//! losses of poses.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_control::{
    Circle, External, InertialSample, Limits, PoseSample, Position, ProportionalLoop, Reference,
    Setpoint, SetpointStamp, SpeedDemand, SteeringDemand, Time, TrackingLoop, Trajectory,
    TrajectoryPoint, VehicleParameters, Velocity, VelocityStep, VelocitySteps,
};
use singletrack_pilot::{
    Arming, BoardRequest, BoardSample, BoardState, Event, LinkState, Mode, Pilot, PilotConfig,
    PilotRequest, Reason, SetpointRefusal, Underway,
};

use crate::bench::{AT_START, Bench, Pose, TICK_NS, config};

#[test]
fn it_drives_only_after_an_explicit_request() {
    let mut bench = Bench::new();
    for _ in 0..2000 {
        let output = bench.step();
        assert!(output.command.is_none() && output.request.is_none());
    }
    assert_eq!(bench.pilot.mode(), Mode::Ready);
}

#[test]
fn an_arm_request_that_comes_too_early_is_refused_with_a_reason_and_not_kept() {
    let mut bench = Bench::new();
    bench.pose = Pose::Missing;
    bench.run(100);
    let output = bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Idle, Some(Reason::NoPose))
    );
    bench.pose = Pose::Seen;
    for _ in 0..300 {
        assert_ne!(bench.step().mode, Mode::Driving);
    }
}

#[test]
fn an_armed_car_that_waits_stands_until_its_reference_begins() {
    let mut bench = Bench::new();
    bench.run(100);
    bench.step_with(Some(PilotRequest::Arm(Arming::Waiting)));
    let mut output = bench.run(3);
    for _ in 0..40 {
        output = bench.step();
        assert_eq!((output.mode, output.drive_time), (Mode::Driving, None));
        assert_eq!(output.command.unwrap().rear_speed, 0.0);
    }
    let start = Time(bench.now().0 + 7_000_000);
    bench.extra.push(Event::Begin(start));
    assert_eq!(
        bench.step().drive_time,
        Some(bench.now().seconds_since(start))
    );
    let mut plain = Bench::new();
    plain.run(100);
    plain.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    while output.drive_time != Some(0.0) {
        output = plain.step();
    }
    // Less than a tick before.
    for _ in 0..100 {
        bench.step_with(Some(PilotRequest::Hold));
        plain.step();
    }
    assert!((bench.position - plain.position).norm() < 3e-3);
    assert!(bench.speed > 0.3);
}

#[test]
fn a_request_to_arm_does_not_begin_the_drive_of_a_car_that_waits() {
    for request in [
        PilotRequest::Arm(Arming::Unattended),
        PilotRequest::Arm(Arming::Held),
        PilotRequest::Arm(Arming::Jog),
    ] {
        let mut bench = Bench::new();
        bench.run(100);
        bench.step_with(Some(PilotRequest::Arm(Arming::Waiting)));
        bench.run(3);
        bench.step_with(Some(request));
        for _ in 0..40 {
            let output = bench.step();
            assert_eq!((output.mode, output.drive_time), (Mode::Driving, None));
            assert_eq!(output.command.unwrap().rear_speed, 0.0, "{request}");
        }
        bench.extra.push(Event::Begin(bench.now()));
        assert!(bench.step().drive_time.is_some());
    }
}

#[test]
fn after_ticks_that_were_left_out_its_reference_begins_with_the_tick() {
    let mut bench = Bench::new();
    bench.run(100);
    bench.step_with(Some(PilotRequest::Arm(Arming::Waiting)));
    bench.run(3);
    bench
        .extra
        .push(Event::Begin(Time(bench.now().0 - 200_000_000)));
    assert_eq!(bench.step().drive_time, Some(0.0));
}

#[test]
fn a_car_that_waits_is_held_and_watched_as_one_that_drives() {
    let waiting = || {
        let mut bench = Bench::new();
        bench.run(100);
        bench.step_with(Some(PilotRequest::Arm(Arming::Waiting)));
        assert_eq!(bench.run(3).mode, Mode::Driving);
        bench
    };
    let mut let_go = waiting();
    let (output, _) = let_go.run_until_idle();
    assert_eq!(output.reason, Some(Reason::OperatorGone));
    let mut unseen = waiting();
    unseen.pose = Pose::Missing;
    let mut output = unseen.step();
    while output.mode.commands() {
        output = unseen.step_with(Some(PilotRequest::Hold));
        assert_eq!(unseen.speed, 0.0);
    }
    assert_eq!(output.reason, Some(Reason::PoseTooOld));
    // The next drive does not wait.
    unseen.pose = Pose::Seen;
    assert_eq!(unseen.run(100).mode, Mode::Ready);
    unseen.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    assert!(unseen.run(3).drive_time.is_some());
}

#[test]
fn a_car_that_is_not_armed_when_its_reference_begins_is_not_armed_later() {
    let mut bench = Bench::new();
    bench.run(100);
    bench.step_with(Some(PilotRequest::Arm(Arming::Waiting)));
    bench.board = BoardState::PoweringUp;
    assert_eq!(bench.run(3).mode, Mode::Arming);
    bench.extra.push(Event::Begin(bench.now()));
    let output = bench.step();
    let late = (Mode::Idle, Some(Reason::BoardTimeout));
    assert_eq!((output.mode, output.reason), late);
    assert_eq!(output.request, Some(BoardRequest::Disarm));
    // Nor if it comes with the request to arm.
    let mut bench = Bench::new();
    bench.run(100);
    bench.extra.push(Event::Begin(bench.now()));
    assert_eq!(
        bench
            .step_with(Some(PilotRequest::Arm(Arming::Waiting)))
            .mode,
        Mode::Ready
    );
}

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
        (0.5, 0.7, 0.88, Some(Reason::BrakesLessThanConfigured)),
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

fn setpoint(bench: &Bench, velocity: Velocity, position: Option<Position>) -> Event {
    let now = Time((bench.tick + 1) * TICK_NS);
    Event::Setpoint(Setpoint::point(now, position, velocity))
}

#[test]
fn external_set_points_are_followed_until_the_last_one_is_too_old() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        ..config()
    });
    let output = bench.run(100);
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Idle, Some(Reason::SetpointStale))
    );
    let mut outputs = Vec::new();
    for tick in 0..200 {
        if tick == 10 {
            bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let event = setpoint(&bench, Velocity::new(0.5, 0.0), None);
        bench.extra.push(event);
        outputs.push(bench.step());
    }
    let last = outputs.last().unwrap();
    assert_eq!((last.mode, last.reason), (Mode::Driving, None));
    assert_eq!(last.point_velocity, Some(Velocity::new(0.5, 0.0)));
    assert!((bench.speed - 0.5).abs() < 0.01);
    // A set-point with a NaN is ignored.
    for _ in 0..20 {
        let event = setpoint(&bench, Velocity::new(f64::NAN, 0.0), None);
        bench.extra.push(event);
        let output = bench.step();
        assert_eq!(output.mode, Mode::Driving);
        assert_eq!(output.setpoint_refused, Some(SetpointRefusal::NotFinite));
    }
    let output = bench.step();
    assert_eq!(output.setpoint_refused, None);
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Stopping, Some(Reason::SetpointStale))
    );
}

#[test]
fn a_set_point_that_is_not_obeyed_shows_in_the_tick_with_the_reason() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        ..config()
    });
    bench.run(100);
    let now = (bench.tick + 1) * TICK_NS;
    let at = |ns| Event::Setpoint(Setpoint::point(Time(ns), None, Velocity::zeros()));
    let mut refused = |events: &[Event]| {
        bench.extra.extend_from_slice(events);
        bench.step().setpoint_refused
    };
    assert_eq!(refused(&[at(now)]), None);
    assert_eq!(refused(&[at(now - 1)]), Some(SetpointRefusal::Superseded));
    assert_eq!(refused(&[at(0)]), Some(SetpointRefusal::Old));
    assert_eq!(refused(&[at(u64::MAX)]), Some(SetpointRefusal::Future));
    // A later one that is obeyed does not hide it.
    let later = at(now + 1);
    assert_eq!(refused(&[at(0), later]), Some(SetpointRefusal::Old));
    assert_eq!(refused(&[]), None);

    let mut circle = Bench::new();
    circle.extra.push(at(TICK_NS));
    let output = circle.step();
    assert_eq!(output.setpoint_refused, Some(SetpointRefusal::NotExternal));
    assert_eq!(output.setpoint, None);
}

#[test]
fn demanded_steering_and_speed_replace_the_law_within_the_limits() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        ..config()
    });
    let limits = config().limits;
    let mut last = None;
    for tick in 0..400 {
        if tick == 100 {
            bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let now = Time((bench.tick + 1) * TICK_NS);
        let (steering, speed) = (SteeringDemand::Angle(1.5), SpeedDemand::Acceleration(50.0));
        let event = Event::Setpoint(Setpoint::actuation(now, steering, speed));
        bench.extra.push(event);
        let output = bench.step();
        assert!(output.point_velocity.is_none() && output.reference.is_none());
        assert_eq!(output.setpoint.map(|stamp| stamp.time), Some(now));
        let actuation = output.actuation;
        if let Some(before) = last.replace(actuation) {
            let rate = (actuation.steering - before.steering) / config().period;
            let change = (actuation.speed - before.speed) / config().period;
            assert!(rate.abs() <= limits.max_steering_rate + 1e-9, "{rate}");
            assert!(change.abs() <= limits.max_acceleration + 1e-9, "{change}");
        }
        assert!(actuation.speed <= limits.max_speed);
    }
    assert_eq!(bench.pilot.mode(), Mode::Driving);
    let last = last.unwrap();
    assert_eq!(last.steering, limits.max_steering);
    assert!((last.speed - limits.speed_in_bend(last.steering)).abs() < 1e-9);
}

#[test]
fn set_points_that_must_not_be_obeyed_keep_no_car_driving() {
    type Mistake = fn(&mut Setpoint);
    let mistakes: [Mistake; 4] = [
        |setpoint| setpoint.stamp.time.0 += 1,
        |setpoint| setpoint.stamp.time = Time(u64::MAX),
        |setpoint| setpoint.stamp.time.0 -= 201_000_000,
        |setpoint| {
            setpoint.demand = singletrack_control::Demand::Actuation {
                steering: SteeringDemand::Angle(f64::NAN),
                speed: SpeedDemand::Speed(0.5),
            };
        },
    ];
    for mistake in mistakes {
        let mut bench = Bench::with(PilotConfig {
            reference: Reference::External(External::new(0.2).unwrap()),
            ..config()
        });
        let mut modes = Vec::new();
        for tick in 0..300 {
            if tick == 100 {
                bench
                    .extra
                    .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
            }
            let now = Time((bench.tick + 1) * TICK_NS);
            let mut setpoint = Setpoint::point(now, None, Velocity::new(0.5, 0.0));
            if tick >= 200 {
                mistake(&mut setpoint);
            }
            bench.extra.push(Event::Setpoint(setpoint));
            let output = bench.step();
            modes.push((output.mode, output.reason));
        }
        // 200 ms after the last one that may be obeyed.
        assert_eq!(modes[219], (Mode::Driving, None));
        assert_eq!(modes[220], (Mode::Stopping, Some(Reason::SetpointStale)));
    }
}

#[test]
fn a_trajectory_is_followed_by_the_outer_loop_and_ends_the_drive_at_its_end() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        tracking: TrackingLoop::Proportional(ProportionalLoop {
            gain: Velocity::new(2.0, 2.0),
            feed_forward: true,
        }),
        ..config()
    });
    let from = bench.run(100).point.unwrap();
    let begin = bench.now();
    for tick in 0..600 {
        if tick == 20 {
            bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let now = Time((bench.tick + 1) * TICK_NS);
        let trajectory = Trajectory {
            stamp: SetpointStamp {
                time: now,
                sequence: Some(tick),
            },
            points: (0..60)
                .map(|index| {
                    let seconds = 0.1 * f64::from(index);
                    let x = 0.2 * (seconds - 0.3).clamp(0.0, 2.5);
                    TrajectoryPoint {
                        time: begin.after(seconds),
                        position: from + Velocity::new(x, 0.0),
                        velocity: Velocity::new(if x > 0.0 && x < 0.5 { 0.2 } else { 0.0 }, 0.0),
                    }
                })
                .filter(|point| point.time <= begin.after(2.8))
                .collect(),
        };
        bench
            .extra
            .extend(trajectory.pieces().map(Event::TrajectoryPiece));
        let output = bench.step();
        match output.mode {
            Mode::Driving => {
                let reference = output.reference.unwrap();
                let off = output.point.unwrap() - reference.position.unwrap();
                assert!(
                    off.norm() < 0.12 || reference.velocity.x < 0.15,
                    "{tick} {off}"
                );
                assert_eq!(output.setpoint.unwrap().sequence, Some(tick));
            }
            Mode::Stopping => {
                assert_eq!(output.reason, Some(Reason::SetpointStale));
                let moved = output.point.unwrap() - from;
                assert!((moved - Velocity::new(0.5, 0.0)).norm() < 0.1, "{moved}");
                return;
            }
            _ => assert!(tick < 25, "{:?}", output.reason),
        }
    }
    panic!("it drove on after the end");
}

#[test]
fn the_position_loop_approaches_an_external_position() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        ..config()
    });
    let target = Position::new(2.0, 0.3);
    for tick in 0..1_500 {
        if tick == 100 {
            bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let event = setpoint(&bench, Velocity::zeros(), Some(target));
        bench.extra.push(event);
        bench.step();
    }
    let point = bench.step().point.unwrap();
    assert!((point - target).norm() < 0.05, "{point}");
}

#[test]
fn the_configuration_is_replaced_only_while_no_drive_is_underway() {
    let other = PilotConfig {
        limits: Limits {
            max_speed: 0.2,
            ..Limits::paper()
        },
        ..config()
    };
    let mut bench = Bench::new();
    bench.drive();
    assert_eq!(
        bench.pilot.reconfigure(&other),
        Err(Underway(Mode::Driving))
    );
    bench.step_with(Some(PilotRequest::Disarm));
    assert_eq!(
        bench.pilot.reconfigure(&other),
        Err(Underway(Mode::Stopping))
    );
    bench.run_until_idle();
    assert_eq!(bench.pilot.reconfigure(&other), Ok(()));
    // The estimate restarts; the state of the board is kept.
    let output = bench.step();
    assert_eq!(output.mode, Mode::Idle);
    assert_eq!(bench.run(100).mode, Mode::Ready);
    bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
    bench.run(200);
    assert!((bench.speed - 0.2).abs() < 0.01, "{}", bench.speed);
}

#[test]
fn the_same_events_give_the_same_bits() {
    let run = || {
        let mut bench = Bench::new();
        bench.drive();
        bench.pose = Pose::Missing;
        bench.run(15);
        bench.pose = Pose::Seen;
        (0..200)
            .map(|_| format!("{:?}", bench.step()))
            .collect::<Vec<_>>()
    };
    assert_eq!(run(), run());
}

#[test]
fn a_disarm_in_the_same_tick_as_an_arm_wins() {
    let mut bench = Bench::new();
    assert_eq!(bench.run(100).mode, Mode::Ready);
    bench.tick += 1;
    let output = bench.pilot.step(
        bench.now(),
        &[
            Event::Request(PilotRequest::Arm(Arming::Unattended)),
            Event::Request(PilotRequest::Disarm),
        ],
    );
    assert_ne!(output.request, Some(BoardRequest::Arm));
    for _ in 0..100 {
        assert!(bench.step().command.is_none());
    }
}

#[test]
fn an_emergency_stop_requested_without_a_link_is_not_forgotten() {
    let mut bench = Bench::new();
    assert_eq!(bench.run(100).mode, Mode::Ready);
    bench.tick += 1;
    let output = bench.pilot.step(
        bench.now(),
        &[
            Event::Link(LinkState::Down),
            Event::Request(PilotRequest::EmergencyStop),
        ],
    );
    assert_eq!(output.request, Some(BoardRequest::EmergencyStop));
    bench.tick += 1;
    bench.pilot.step(bench.now(), &AT_START);
    for _ in 0..200 {
        let output = bench.step_with(Some(PilotRequest::Arm(Arming::Unattended)));
        assert_eq!(output.mode, Mode::Fault);
        assert_eq!(output.reason, Some(Reason::EmergencyStop));
    }
    // An explicit disarm clears it.
    bench.step_with(Some(PilotRequest::Disarm));
    assert_eq!(bench.run(5).mode, Mode::Ready);
}

#[test]
fn a_board_that_was_reset_after_an_emergency_stop_can_be_armed_again() {
    let mut bench = Bench::new();
    bench.drive();
    bench.step_with(Some(PilotRequest::EmergencyStop));
    bench.run(20);
    assert_eq!(bench.pilot.mode(), Mode::Fault);
    bench.board = BoardState::Neutral;
    assert_eq!(bench.run(100).mode, Mode::Ready);
}

#[test]
fn a_link_that_flaps_does_not_clear_a_fault() {
    let mut bench = Bench::new();
    bench.drive();
    bench.step_with(Some(PilotRequest::EmergencyStop));
    for link in [LinkState::Down, LinkState::Ready] {
        bench.tick += 1;
        let output = bench.pilot.step(bench.now(), &[Event::Link(link)]);
        assert_eq!(output.mode, Mode::Fault);
    }
}

#[test]
fn poses_older_than_the_prediction_reaches_still_move_the_estimate() {
    let latency = 45_000_000;
    let mut pilot = Pilot::new(config());
    pilot.step(Time(1), &[Event::Link(LinkState::Ready)]);
    let mut last = None;
    for tick in 100..400_u64 {
        let now = Time(tick * TICK_NS);
        let capture = Time(now.0 - latency);
        let position = |time: Time| Position::new(time.0 as f64 * 1e-9 * 0.5, 0.0);
        let output = pilot.step(
            now,
            &[
                Event::Board(BoardSample {
                    time: now,
                    inertial: Some(InertialSample {
                        time: now,
                        yaw_rate: 0.0,
                        forward_acceleration: 0.0,
                        left_acceleration: 0.0,
                    }),
                    motor_speed: 0.5,
                    state: BoardState::Neutral,
                }),
                Event::Pose(PoseSample {
                    capture,
                    receive: now,
                    frame: i32::try_from(tick).unwrap(),
                    position: position(capture),
                    yaw: 0.0,
                }),
            ],
        );
        last = output
            .estimate
            .map(|estimate| (estimate.position - position(now)).norm());
    }
    assert!(last.unwrap() < 0.02, "{last:?}");
}

#[test]
fn the_estimate_settles_again_after_an_imu_was_silent() {
    let mut bench = Bench::new();
    assert_eq!(bench.run(100).mode, Mode::Ready);
    bench.imu = false;
    bench.run(100);
    bench.imu = true;
    let output = bench.run(3);
    assert_eq!(output.reason, Some(Reason::EstimateUnsettled));
    assert_eq!(bench.run(60).mode, Mode::Ready);
}

#[test]
fn a_present_failure_replaces_the_reason_of_the_last_stop() {
    let mut bench = Bench::new();
    bench.drive();
    bench.step_with(Some(PilotRequest::Disarm));
    let (output, _) = bench.run_until_idle();
    assert_eq!(output.reason, Some(Reason::Requested));
    bench.pose = Pose::Missing;
    assert_eq!(bench.run(50).reason, Some(Reason::PoseTooOld));
}

#[test]
fn a_board_that_is_still_armed_is_not_driven_and_is_disarmed_on_request() {
    let mut bench = Bench::new();
    bench.board = BoardState::Armed;
    let output = bench.run(100);
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Idle, Some(Reason::BoardArmed))
    );
    let output = bench.step_with(Some(PilotRequest::Disarm));
    assert_eq!(output.request, Some(BoardRequest::Disarm));
}

#[test]
fn a_body_where_the_car_cannot_have_come_to_is_the_car_only_when_the_operator_says_so() {
    let mut bench = Bench::new();
    assert_eq!(bench.run(100).mode, Mode::Ready);
    let was = bench.position;
    // Its wheels have not turned: it was carried, or it is another body.
    bench.position = Position::new(2.0, -1.0);
    let output = bench.run(500);
    assert_eq!(
        (output.mode, output.preflight),
        (Mode::Idle, Some(Reason::PoseImplausible))
    );
    let estimate = output.estimate.unwrap();
    assert!((estimate.position - was).norm() < 0.1);
    // A program that ends disarms as well, and may put another configuration in force.
    bench.step_with(Some(PilotRequest::Disarm));
    bench.pilot.reconfigure(&config()).unwrap();
    let output = bench.run(100);
    assert_eq!(output.preflight, Some(Reason::PoseImplausible));
    bench.step_with(Some(PilotRequest::Carried));
    let output = bench.run(100);
    assert_eq!((output.mode, output.reason), (Mode::Ready, None));
    let estimate = output.estimate.unwrap();
    assert!((estimate.position - bench.position).norm() < 0.01);
}

#[test]
fn a_car_that_is_seen_again_where_it_was_needs_no_word_of_the_operator() {
    let mut bench = Bench::new();
    assert_eq!(bench.run(100).mode, Mode::Ready);
    let was = bench.position;
    // A ghost for five seconds.
    bench.position = Position::new(2.0, -1.0);
    bench.run(500);
    bench.position = was;
    assert_eq!(bench.run(100).mode, Mode::Ready);
}

#[test]
fn the_command_has_the_speed_of_the_rear_axle() {
    let vehicle = VehicleParameters::paper();
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::Circle(Circle::new(Position::origin(), 1.0, 0.5).unwrap()),
        ..config()
    });
    bench.position = Position::new(0.75, -0.3);
    bench.yaw = 1.4;
    bench.drive();
    let output = bench.run(1_000);
    let command = output.command.unwrap();
    assert!(command.steering > 0.2, "the car does not turn");
    // G and the rear axle turn about one point, beside the rear axle.
    let yaw_rate = command.rear_speed * command.steering.tan() / vehicle.wheelbase_m();
    let sideways = vehicle.rear_axle_distance_m * yaw_rate;
    let speed = command.rear_speed.hypot(sideways);
    assert!((speed - output.actuation.speed).abs() < 0.002, "{speed}");
}
