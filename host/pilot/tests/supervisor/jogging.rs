//! Jogging: what it needs, and all its ends.

use singletrack_pilot::{Arming, BoardRequest, BoardState, Event, Jog, Mode, PilotRequest, Reason};

use crate::bench::{Bench, FAILURES, HEALTHY, STANDING_FAILURES, TICK_NS, battery, steps};

const JOG: Event = Event::Jog(Jog {
    servo_us: 1_500,
    esc_us: 1_500,
});

fn jogging() -> Bench {
    let mut bench = Bench::new();
    assert_eq!(
        bench.ask(PilotRequest::Arm(Arming::Jog)),
        (Mode::Arming, None, Some(BoardRequest::Arm))
    );
    bench.supervisor.handle_board(BoardState::Armed);
    assert_eq!(bench.step(), (Mode::Jogging, None, None));
    bench.supervisor.handle_board(BoardState::Jogging);
    bench
}

/// What matters without poses, IMU, geofence and reference.
const MATTERS: [Reason; 4] = [
    Reason::StopInputOpen,
    Reason::BatteryLow,
    Reason::BatteryOpen,
    Reason::LineNoisy,
];

fn matters(reason: Reason) -> bool {
    MATTERS.contains(&reason) || reason == Reason::DeadlineMissed
}

#[test]
fn only_board_battery_line_and_ticks_matter_before_and_while_jogging() {
    for (name, reason, failure) in FAILURES {
        let mut bench = Bench::new();
        failure(&mut bench);
        let armed = bench.ask(PilotRequest::Arm(Arming::Jog));
        let refused = (Mode::Idle, Some(reason), None);
        assert_eq!(armed == refused, matters(reason), "{name}: {armed:?}");

        let mut bench = jogging();
        bench.supervisor.handle(&JOG);
        let ended = bench.after(failure);
        let stops = (Mode::Idle, Some(reason), Some(BoardRequest::Disarm));
        assert_eq!(ended == stops, matters(reason), "{name}: {ended:?}");
        assert_eq!(ended.0 == Mode::Jogging, !matters(reason), "{name}");
    }
}

#[test]
fn wheels_that_turn_a_low_battery_and_a_board_that_is_not_ready_refuse_it() {
    for (name, reason, failure) in STANDING_FAILURES {
        let mut bench = Bench::new();
        failure(&mut bench);
        let stays = match name {
            "wheels that turn" => true,
            _ => matches!(
                reason,
                Reason::BatteryLow | Reason::BoardBooting | Reason::BoardArmed
            ),
        };
        let (mode, _, request) = bench.ask(PilotRequest::Arm(Arming::Jog));
        assert_eq!(mode == Mode::Idle, stays, "{name}");
        assert_eq!(request.is_none(), stays, "{name}");
    }
    let mut bench = Bench::new();
    bench.conditions.motor_speed = f64::NAN;
    assert_eq!(
        bench.ask(PilotRequest::Arm(Arming::Jog)).1,
        Some(Reason::Moving)
    );
}

#[test]
fn pulses_alone_hold_it_and_0_25_s_without_them_end_it() {
    for held in [false, true] {
        let mut bench = jogging();
        for _ in 0..10 {
            bench.supervisor.handle(&JOG);
            assert_eq!(steps(&mut bench, 250).0, Mode::Jogging);
        }
        bench.supervisor.handle(&JOG);
        assert_eq!(bench.step().0, Mode::Jogging);
        let mut left = (Mode::Jogging, None, None);
        for _ in 0..26 {
            if held {
                bench.supervisor.handle(&Event::Request(PilotRequest::Hold));
            }
            assert_eq!(left.0, Mode::Jogging);
            left = bench.step();
        }
        let gone = Some(Reason::OperatorGone);
        assert_eq!(left, (Mode::Idle, gone, Some(BoardRequest::Disarm)));
    }
}

#[test]
fn it_ends_at_once_on_request_without_a_ramp() {
    for (request, reason) in [
        (PilotRequest::Disarm, Reason::Requested),
        (PilotRequest::OperatorGone, Reason::OperatorGone),
        (PilotRequest::TimeUp, Reason::TimeUp),
    ] {
        let mut bench = jogging();
        bench.conditions.motor_speed = 0.6;
        bench.supervisor.handle(&JOG);
        let ended = (Mode::Idle, Some(reason), Some(BoardRequest::Disarm));
        assert_eq!(bench.ask(request), ended);
    }
    let mut bench = jogging();
    let stopped = (
        Mode::Fault,
        Some(Reason::EmergencyStop),
        Some(BoardRequest::EmergencyStop),
    );
    assert_eq!(bench.ask(PilotRequest::EmergencyStop), stopped);
}

#[test]
fn a_board_that_stops_ends_it() {
    for (board, mode, reason) in [
        (BoardState::Failsafe, Mode::Idle, Reason::BoardFailsafe),
        (BoardState::Neutral, Mode::Idle, Reason::BoardFailsafe),
        (BoardState::Booting, Mode::Idle, Reason::BoardFailsafe),
        (
            BoardState::EmergencyStopped,
            Mode::Fault,
            Reason::EmergencyStop,
        ),
        (
            BoardState::RunsAtNeutral,
            Mode::Fault,
            Reason::RunsAtNeutral,
        ),
    ] {
        let mut bench = jogging();
        bench.supervisor.handle(&JOG);
        bench.supervisor.handle_board(board);
        assert_eq!(bench.step(), (mode, Some(reason), None), "{board:?}");
    }
}

#[test]
fn a_drive_never_becomes_jogging_and_jogging_never_a_drive() {
    let mut bench = Bench::driving();
    bench.supervisor.handle(&JOG);
    assert_eq!(bench.ask(PilotRequest::Arm(Arming::Jog)).0, Mode::Driving);
    let mut bench = jogging();
    bench.supervisor.handle(&JOG);
    assert_eq!(
        bench.ask(PilotRequest::Arm(Arming::Unattended)).0,
        Mode::Jogging
    );
    bench.supervisor.handle_board(BoardState::Armed);
    assert_eq!(bench.step().0, Mode::Jogging);
    // A request before it is not kept either.
    bench.ask(PilotRequest::Disarm);
    bench.supervisor.handle_board(BoardState::Neutral);
    bench.step();
    assert_eq!(
        bench.ask(PilotRequest::Arm(Arming::Unattended)).0,
        Mode::Arming
    );
    bench.supervisor.handle_board(BoardState::Armed);
    assert_eq!(bench.step().0, Mode::Driving);
}

#[test]
fn a_refused_request_says_why_and_what_forbids_a_drive_stays_apart() {
    let mut bench = Bench::new();
    bench.pose_age_ms = u64::MAX;
    bench.health = battery(6_399);
    assert_eq!(
        bench.ask(PilotRequest::Arm(Arming::Jog)).1,
        Some(Reason::BatteryLow)
    );
    bench.health = Some(HEALTHY);
    assert_eq!(bench.step().1, Some(Reason::NoPose));
    assert_eq!(bench.supervisor.preflight(), Some(Reason::NoPose));
    assert_eq!(bench.ask(PilotRequest::Arm(Arming::Jog)).0, Mode::Arming);
}

#[test]
fn arming_to_jog_ends_when_the_hand_does_not_hold_it_or_the_wheels_turn() {
    let mut bench = Bench::new();
    bench.ask(PilotRequest::Arm(Arming::Jog));
    bench.supervisor.handle_board(BoardState::PoweringUp);
    for _ in 0..2_000_000_000 / TICK_NS {
        bench.supervisor.handle(&Event::Request(PilotRequest::Hold));
        assert_eq!(bench.step().0, Mode::Arming);
    }
    assert_eq!(steps(&mut bench, 520).1, Some(Reason::OperatorGone));

    let mut bench = Bench::new();
    bench.ask(PilotRequest::Arm(Arming::Jog));
    bench.conditions.motor_speed = 0.2;
    let moves = (Mode::Idle, Some(Reason::Moving), Some(BoardRequest::Disarm));
    assert_eq!(bench.step(), moves);
}

#[test]
fn a_disarm_in_the_same_tick_wins_over_a_request_to_jog() {
    let mut bench = Bench::new();
    bench
        .supervisor
        .handle(&Event::Request(PilotRequest::Arm(Arming::Jog)));
    assert_eq!(bench.ask(PilotRequest::Disarm).0, Mode::Ready);
}
