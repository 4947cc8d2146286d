//! The way from a stop to the disarm; age and distance of the last pose.

use singletrack_pilot::{BoardRequest, BoardState, Mode, PilotRequest, Reason, SupervisorConfig};

use crate::bench::Bench;

#[test]
fn a_slowing_car_stops_on_a_disarm_and_when_its_board_has_stopped() {
    assert_eq!(
        Bench::slowing().ask(PilotRequest::Disarm),
        (Mode::Stopping, Some(Reason::Requested), None)
    );
    for (state, mode, reason) in [
        (BoardState::Failsafe, Mode::Idle, Reason::BoardFailsafe),
        (BoardState::Neutral, Mode::Idle, Reason::BoardFailsafe),
        (
            BoardState::EmergencyStopped,
            Mode::Fault,
            Reason::EmergencyStop,
        ),
    ] {
        for mut bench in [Bench::slowing(), Bench::driving()] {
            bench.supervisor.handle_board(state);
            assert_eq!(bench.step(), (mode, Some(reason), None));
        }
    }
}

#[test]
fn a_stopping_car_with_poses_is_disarmed_when_it_stands() {
    let mut bench = Bench::driving();
    bench.ask(PilotRequest::Disarm);
    bench.conditions.commanded_speed = 0.0;
    for _ in 0..100 {
        assert_eq!(bench.step().0, Mode::Stopping, "the car rolls");
    }
    bench.conditions.motor_speed = -0.03;
    assert_eq!(bench.step().0, Mode::Stopping, "the car still rolls");
    bench.conditions.motor_speed = 0.029;
    assert_eq!(
        bench.step(),
        (
            Mode::Idle,
            Some(Reason::Requested),
            Some(BoardRequest::Disarm)
        )
    );
}

#[test]
fn a_stopping_car_without_poses_is_disarmed_a_tenth_of_a_second_after_the_command_to_stand() {
    let mut bench = Bench::slowing();
    bench.pose_age_ms = 601;
    bench.step();
    for _ in 0..3 {
        assert_eq!(
            bench.step().0,
            Mode::Stopping,
            "the command is not zero yet"
        );
    }
    // The command of the tick before.
    bench.conditions.commanded_speed = 0.0;
    for tick in 1..10 {
        assert_eq!(bench.step().0, Mode::Stopping, "{tick}");
    }
    assert_eq!(bench.step().2, Some(BoardRequest::Disarm));
    assert_eq!(bench.supervisor.mode(), Mode::Idle);
}

#[test]
fn a_stop_ends_with_a_disarm_after_its_timeout() {
    let mut bench = Bench::driving();
    bench.ask(PilotRequest::Disarm);
    for _ in 0..150 {
        assert_eq!(
            bench.step(),
            (Mode::Stopping, Some(Reason::Requested), None)
        );
    }
    assert_eq!(
        bench.step(),
        (
            Mode::Idle,
            Some(Reason::Requested),
            Some(BoardRequest::Disarm)
        )
    );
}

#[test]
fn a_stopping_car_is_disarmed_when_motor_and_cameras_see_it_stand() {
    let stopping = || {
        let mut bench = Bench::driving();
        bench.ask(PilotRequest::Disarm);
        bench.conditions.commanded_speed = 0.0;
        bench
    };
    for (motor_speed, camera_speed, disarms) in [
        (0.0, Some(0.0), true),
        (0.0, None, true),
        (0.03, Some(0.0), false),
        (0.0, Some(0.03), false),
        (0.0, Some(0.029), true),
    ] {
        let mut bench = stopping();
        bench.conditions.motor_speed = motor_speed;
        bench.conditions.camera_speed = camera_speed;
        let disarmed = bench.step().2 == Some(BoardRequest::Disarm);
        assert_eq!(disarmed, disarms, "{motor_speed} {camera_speed:?}");
    }
}

#[test]
fn the_board_is_disarmed_before_it_must_stop_the_car_by_itself() {
    // Limits that the check of the configuration would refuse.
    let limits = SupervisorConfig {
        hold: 2.0,
        blind: 2.0,
        disarm_age: 0.5,
        ..SupervisorConfig::paper()
    };
    for stopping in [false, true] {
        let mut bench = Bench::driving();
        bench.supervisor.reconfigure(limits);
        if stopping {
            bench.ask(PilotRequest::Disarm);
        }
        bench.pose_age_ms = 499;
        assert_eq!(bench.step().2, None);
        bench.pose_age_ms = 500;
        let (mode, _, request) = bench.step();
        assert_eq!((mode, request), (Mode::Idle, Some(BoardRequest::Disarm)));
    }
}

#[test]
fn a_pose_is_held_up_to_its_time_and_distance() {
    let mut bench = Bench::driving();
    bench.pose_age_ms = 300;
    bench.conditions.blind_distance = 0.15;
    assert_eq!(bench.step(), (Mode::Driving, None, None));
    bench.conditions.blind_distance = 0.151;
    assert_eq!(
        bench.step(),
        (Mode::Slowing, Some(Reason::BlindTooFar), None)
    );
}

#[test]
fn a_slowing_car_drives_on_after_three_fresh_poses_and_not_before() {
    let mut bench = Bench::slowing();
    for age_ms in [600, 299, 51] {
        bench.pose_age_ms = age_ms;
        assert_eq!(bench.step().0, Mode::Slowing, "{age_ms} ms");
    }
    bench.pose_age_ms = 50;
    for _ in 0..2 {
        // A single pose may be of another body.
        bench.conditions.poses += 1;
        assert_eq!(
            bench.step(),
            (Mode::Slowing, Some(Reason::PoseTooOld), None)
        );
    }
    bench.conditions.poses += 1;
    assert_eq!(bench.step(), (Mode::Driving, None, None));
    // The reason of the slowing does not stay.
    bench.ask(PilotRequest::Disarm);
    assert_eq!(bench.supervisor.reason(), Some(Reason::Requested));
}

#[test]
fn a_slowing_car_stops_for_good_beyond_its_blind_distance() {
    let mut bench = Bench::slowing();
    bench.pose_age_ms = 600;
    bench.conditions.blind_distance = 0.45;
    assert_eq!(bench.step().0, Mode::Slowing);
    bench.conditions.blind_distance = 0.451;
    assert_eq!(
        bench.step(),
        (Mode::Stopping, Some(Reason::BlindTooFar), None)
    );
}

#[test]
fn a_slowing_car_at_rest_stops_for_good_beyond_its_blind_time() {
    let mut bench = Bench::slowing();
    bench.conditions.commanded_speed = 0.0;
    bench.pose_age_ms = 600;
    assert_eq!(bench.step().0, Mode::Slowing);
    bench.pose_age_ms = 601;
    assert_eq!(
        bench.step(),
        (Mode::Stopping, Some(Reason::PoseTooOld), None)
    );
}

#[test]
fn an_estimate_that_restarted_while_slowing_needs_three_poses() {
    let mut bench = Bench::slowing();
    bench.pose_age_ms = 10;
    for (poses, mode) in [(1, Mode::Slowing), (2, Mode::Slowing), (3, Mode::Driving)] {
        bench.conditions.poses = poses;
        assert_eq!(bench.step().0, mode, "{poses}");
    }
}
