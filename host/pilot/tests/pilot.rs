//! The pilot on an ideal car that follows every command exactly: modes, reasons, and the order of what
//! comes in a tick.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_control::{
    Circle, InertialSample, Limits, PoseSample, Position, Reference, Time, VehicleParameters,
};
use singletrack_pilot::{
    Arming, BoardRequest, BoardSample, BoardState, Event, LinkState, Mode, Pilot, PilotConfig,
    PilotRequest, Reason, Underway,
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
