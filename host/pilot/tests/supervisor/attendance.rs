//! Held, timed and unattended drives.

use singletrack_control::Time;
use singletrack_pilot::{
    Arming, BoardRequest, BoardState, Mode, PilotRequest, Reason, SupervisorConfig,
};

use crate::bench::{Bench, steps};

#[test]
fn a_held_drive_ends_half_a_second_after_its_last_renewal() {
    let mut bench = Bench::new();
    bench.step();
    assert_eq!(bench.ask(PilotRequest::Arm(Arming::Held)).0, Mode::Arming);
    bench.supervisor.handle_board(BoardState::Armed);
    assert_eq!(bench.step().0, Mode::Driving);
    for _ in 0..4 {
        assert_eq!(steps(&mut bench, 490).0, Mode::Driving);
        assert_eq!(bench.ask(PilotRequest::Hold).0, Mode::Driving);
    }
    assert_eq!(steps(&mut bench, 500).0, Mode::Driving);
    assert_eq!(
        bench.step(),
        (Mode::Stopping, Some(Reason::OperatorGone), None)
    );
    // A late renewal does not continue it.
    bench.conditions.commanded_speed = 0.1;
    assert_eq!(bench.ask(PilotRequest::Hold).0, Mode::Stopping);
}

#[test]
fn a_held_drive_that_is_not_renewed_while_the_board_arms_is_not_begun() {
    let mut bench = Bench::unconnected(SupervisorConfig {
        arm_timeout: 2.0,
        ..SupervisorConfig::paper()
    });
    bench.connect();
    bench.step();
    assert_eq!(bench.ask(PilotRequest::Arm(Arming::Held)).0, Mode::Arming);
    assert_eq!(steps(&mut bench, 500).0, Mode::Arming);
    assert_eq!(
        bench.step(),
        (
            Mode::Idle,
            Some(Reason::OperatorGone),
            Some(BoardRequest::Disarm)
        )
    );
}

#[test]
fn an_unattended_drive_needs_no_renewal_and_a_renewal_makes_none() {
    let mut bench = Bench::new();
    bench.step();
    // Without an arm request it has no effect.
    assert_eq!(bench.ask(PilotRequest::Hold), (Mode::Ready, None, None));
    let mut bench = Bench::driving();
    assert_eq!(bench.ask(PilotRequest::Hold).0, Mode::Driving);
    assert_eq!(steps(&mut bench, 2_000).0, Mode::Driving);
}

#[test]
fn a_dead_man_switch_that_is_lost_disarms_a_rolling_car_in_the_same_tick() {
    let gone = (
        Mode::Idle,
        Some(Reason::OperatorGone),
        Some(BoardRequest::Disarm),
    );
    assert_eq!(Bench::driving().ask(PilotRequest::Halt), gone);
    assert_eq!(Bench::arming().ask(PilotRequest::Halt), gone);
    // Also while the car slows down for another reason.
    let mut bench = Bench::driving();
    assert_eq!(bench.ask(PilotRequest::TimeUp).0, Mode::Stopping);
    assert_eq!(bench.ask(PilotRequest::Halt), gone);
    // It revokes an arm of the same tick, and clears no fault.
    let mut bench = Bench::new();
    bench.step();
    bench
        .supervisor
        .handle_request(PilotRequest::Arm(Arming::Held));
    assert_eq!(bench.ask(PilotRequest::Halt), (Mode::Ready, None, None));
    bench.supervisor.fault(Reason::LawSingular, Time(0));
    assert_eq!(bench.ask(PilotRequest::Halt).0, Mode::Fault);
}

#[test]
fn an_operator_who_is_gone_and_a_time_that_is_over_end_a_drive_with_their_reasons() {
    for (request, reason) in [
        (PilotRequest::OperatorGone, Reason::OperatorGone),
        (PilotRequest::TimeUp, Reason::TimeUp),
    ] {
        assert_eq!(
            Bench::driving().ask(request),
            (Mode::Stopping, Some(reason), None)
        );
        assert_eq!(
            Bench::arming().ask(request),
            (Mode::Idle, Some(reason), Some(BoardRequest::Disarm))
        );
        // It revokes an arm of the same tick, and clears no fault.
        let mut bench = Bench::new();
        bench.step();
        bench
            .supervisor
            .handle_request(PilotRequest::Arm(Arming::Held));
        assert_eq!(bench.ask(request).0, Mode::Ready);
        bench.supervisor.fault(Reason::LawSingular, Time(0));
        assert_eq!(bench.ask(request).0, Mode::Fault);
        assert_eq!(bench.ask(PilotRequest::Disarm).0, Mode::Idle);
    }
}
