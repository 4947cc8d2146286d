//! What only a person clears: faults, contradictions, and what the watches find. Also what would end
//! the drive of a car that something else drives.

use singletrack_control::Time;
use singletrack_pilot::{
    Arming, BoardRequest, BoardState, Event, LinkState, Mode, PilotRequest, Reason,
    SupervisorConfig,
};

use crate::bench::{Bench, DRIVING_FAILURES, FAILURES, steps};

#[test]
fn an_earlier_emergency_stop_does_not_clear_a_fault_of_the_law() {
    let mut bench = Bench::driving();
    bench.ask(PilotRequest::EmergencyStop);
    bench.supervisor.handle_board(BoardState::EmergencyStopped);
    assert_eq!(bench.step().0, Mode::Fault);
    bench.supervisor.handle_board(BoardState::Neutral);
    bench.conditions = Bench::new().conditions;
    bench.step();
    bench.ask(PilotRequest::Arm(Arming::Unattended));
    bench.supervisor.handle_board(BoardState::Armed);
    assert_eq!(bench.step().0, Mode::Driving);
    let now = bench.conditions.now;
    bench.supervisor.fault(Reason::LawSingular, now);
    bench.supervisor.handle_board(BoardState::Neutral);
    for _ in 0..100 {
        assert_eq!(bench.step(), (Mode::Fault, Some(Reason::LawSingular), None));
    }
    assert_eq!(bench.ask(PilotRequest::Disarm).0, Mode::Idle);
}

#[test]
fn a_configuration_refused_for_an_emergency_stop_has_that_reason() {
    let mut bench = Bench::new();
    bench
        .supervisor
        .handle(&Event::Link(LinkState::EmergencyStopped));
    assert_eq!(
        bench.step(),
        (Mode::Disconnected, Some(Reason::EmergencyStop), None)
    );
}

#[test]
fn a_latched_run_at_neutral_is_a_fault_until_the_board_is_reset() {
    let mut bench = Bench::driving();
    bench.supervisor.handle_board(BoardState::RunsAtNeutral);
    assert_eq!(
        bench.step(),
        (Mode::Fault, Some(Reason::RunsAtNeutral), None)
    );
    assert_eq!(bench.ask(PilotRequest::Disarm).0, Mode::Fault);
    bench.supervisor.handle_board(BoardState::Booting);
    assert_eq!(bench.step().0, Mode::Idle);

    let mut bench = Bench::new();
    bench.supervisor.handle_board(BoardState::RunsAtNeutral);
    assert_eq!(
        bench.ask(PilotRequest::Arm(Arming::Unattended)),
        (Mode::Idle, Some(Reason::RunsAtNeutral), None)
    );
}

#[test]
fn a_contradiction_needs_an_acknowledgement_before_the_next_drive() {
    let in_the_first_metre: fn(&mut Bench, Reason) =
        |bench, reason| bench.conditions.contradiction = Some(reason);
    let later: fn(&mut Bench, Reason) =
        |bench, reason| bench.conditions.implausible_motion = Some(reason);
    for (find, reason) in [
        (in_the_first_metre, Reason::SteeringReversed),
        (in_the_first_metre, Reason::MotorSpeedMismatch),
        (later, Reason::SteeringDiffers),
        (later, Reason::AccelerometerDiffers),
        (later, Reason::SideslipImplausible),
    ] {
        let mut bench = Bench::driving();
        find(&mut bench, reason);
        assert_eq!(bench.step(), (Mode::Stopping, Some(reason), None));
        // A disarm while it still stops acknowledges nothing.
        assert_eq!(bench.ask(PilotRequest::Disarm).0, Mode::Stopping);
        bench.conditions = Bench::new().conditions;
        assert_eq!(bench.step().2, Some(BoardRequest::Disarm));
        bench.supervisor.handle_board(BoardState::Neutral);
        for request in [
            PilotRequest::Arm(Arming::Unattended),
            PilotRequest::Arm(Arming::Held),
            PilotRequest::TimeUp,
            PilotRequest::Arm(Arming::Unattended),
        ] {
            assert_eq!(bench.ask(request), (Mode::Idle, Some(reason), None));
            assert_eq!(bench.supervisor.preflight(), Some(reason));
        }
        assert_eq!(bench.ask(PilotRequest::Disarm).0, Mode::Ready);
        assert_eq!(
            bench.ask(PilotRequest::Arm(Arming::Unattended)).0,
            Mode::Arming
        );
    }
}

#[test]
fn what_the_watches_find_refuses_and_stops() {
    let preflight: fn(&mut Bench) =
        |bench| bench.conditions.preflight = Some(Reason::BrakesLessThanConfigured);
    let doubt: fn(&mut Bench) = |bench| bench.conditions.doubt = Some(Reason::PoseFrozen);
    let motion: fn(&mut Bench) =
        |bench| bench.conditions.implausible_motion = Some(Reason::SideslipImplausible);
    for (cause, reason, refuses, stops) in [
        (preflight, Reason::BrakesLessThanConfigured, true, false),
        (doubt, Reason::PoseFrozen, true, true),
        (motion, Reason::SideslipImplausible, false, true),
    ] {
        let (mode, found, _) = Bench::new().after(cause);
        let expected = if refuses {
            (Mode::Idle, Some(reason))
        } else {
            (Mode::Ready, None)
        };
        assert_eq!((mode, found), expected);
        let (mode, found, _) = Bench::driving().after(cause);
        let expected = if stops {
            (Mode::Stopping, Some(reason))
        } else {
            (Mode::Driving, None)
        };
        assert_eq!((mode, found), expected);
    }
}

#[test]
fn a_stop_that_was_not_obeyed_is_cleared_by_a_disarm_of_a_standing_car_only() {
    let mut bench = Bench::driving();
    let now = bench.conditions.now;
    assert_eq!(
        bench.supervisor.stop_not_obeyed(now),
        BoardRequest::EmergencyStop
    );
    let stays = (Mode::Fault, Some(Reason::StopNotObeyed), None);
    bench.conditions.stands = false;
    bench.supervisor.handle_board(BoardState::EmergencyStopped);
    assert_eq!(bench.step(), stays);
    assert_eq!(bench.ask(PilotRequest::Disarm), stays);
    // A reset of the board, a lost link and a standing car clear nothing.
    bench.supervisor.handle_board(BoardState::Booting);
    assert_eq!(bench.step(), stays);
    bench.supervisor.handle(&Event::Link(LinkState::Down));
    assert_eq!(bench.step(), stays);
    bench.conditions.stands = true;
    assert_eq!(steps(&mut bench, 5_000), stays);
    assert_eq!(bench.ask(PilotRequest::OperatorGone), stays);
    // Another emergency stop does not hide it.
    assert_eq!(
        bench.ask(PilotRequest::EmergencyStop),
        (
            Mode::Fault,
            Some(Reason::StopNotObeyed),
            Some(BoardRequest::EmergencyStop)
        )
    );
    assert_eq!(bench.ask(PilotRequest::Disarm).0, Mode::Idle);
}

#[test]
fn a_stop_that_contradicts_no_proof_needs_no_acknowledgement() {
    for reason in [Reason::EstimateInconsistent, Reason::PoseHeight] {
        let mut bench = Bench::driving();
        bench.conditions.implausible_motion = Some(reason);
        assert_eq!(bench.step(), (Mode::Stopping, Some(reason), None));
        assert!(!bench.supervisor.is_contradicted());
        bench.conditions = Bench::new().conditions;
        assert_eq!(bench.step().2, Some(BoardRequest::Disarm));
        bench.supervisor.handle_board(BoardState::Neutral);
        assert_eq!(bench.step().0, Mode::Ready);
        assert_eq!(
            bench.ask(PilotRequest::Arm(Arming::Unattended)).0,
            Mode::Arming
        );
    }
}

#[test]
fn a_contradiction_is_shown_until_it_is_acknowledged() {
    let mut bench = Bench::driving();
    assert!(!bench.supervisor.is_contradicted());
    bench.conditions.contradiction = Some(Reason::GyroDiffers);
    bench.step();
    assert!(bench.supervisor.is_contradicted());
    bench.conditions = Bench::new().conditions;
    bench.step();
    bench.supervisor.handle_board(BoardState::Neutral);
    bench.ask(PilotRequest::TimeUp);
    assert!(bench.supervisor.is_contradicted());
    bench.ask(PilotRequest::Disarm);
    assert!(!bench.supervisor.is_contradicted());
}

#[test]
fn an_emergency_stop_hides_every_other_fault_than_a_stop_that_was_not_obeyed() {
    let emergency = (
        Mode::Fault,
        Some(Reason::EmergencyStop),
        Some(BoardRequest::EmergencyStop),
    );
    let mut bench = Bench::driving();
    let now = bench.conditions.now;
    bench.supervisor.fault(Reason::LawSingular, now);
    assert_eq!(bench.ask(PilotRequest::EmergencyStop), emergency);

    // One that was cleared is no fault any more.
    let mut bench = Bench::driving();
    bench.supervisor.stop_not_obeyed(now);
    assert_eq!(
        bench.ask(PilotRequest::Disarm),
        (
            Mode::Idle,
            Some(Reason::StopNotObeyed),
            Some(BoardRequest::Disarm)
        )
    );
    assert_eq!(bench.ask(PilotRequest::EmergencyStop), emergency);
}

#[test]
fn a_mode_begins_at_the_tick_that_enters_it() {
    let mut bench = Bench::driving();
    bench.ask(PilotRequest::Disarm);
    let begin = bench.conditions.now;
    steps(&mut bench, 500);
    assert_eq!(bench.supervisor.mode(), Mode::Stopping);
    assert_eq!(bench.supervisor.since(), begin);
}

/// What would end the drive, in the next tick.
fn observed(bench: &mut Bench, drives: bool) -> (bool, Option<Reason>) {
    bench.prepare();
    let begins = bench.supervisor.observe(drives, bench.conditions.now);
    (begins, bench.supervisor.observed(&bench.conditions))
}

fn observing(mut bench: Bench) -> Bench {
    assert_eq!(observed(&mut bench, true), (true, None));
    bench.conditions.speed = 0.5;
    bench.conditions.motor_speed = 0.5;
    assert_eq!(observed(&mut bench, true), (false, None));
    bench
}

#[test]
fn a_drive_begins_where_the_car_is_driven_after_it_was_not() {
    let mut bench = Bench::new();
    let drives = [false, true, true, false, false, true, true];
    let begins = [false, true, false, false, false, true, false];
    for (tick, (drives, begins)) in drives.into_iter().zip(begins).enumerate() {
        assert_eq!(observed(&mut bench, drives), (begins, None), "tick {tick}");
        let mode = if drives { Mode::Driving } else { Mode::Idle };
        assert_eq!(bench.supervisor.mode(), mode, "tick {tick}");
        assert_eq!(bench.supervisor.reason(), None, "tick {tick}");
    }
}

#[test]
fn every_failure_would_end_an_observed_drive_and_is_told_again_in_each_tick() {
    for (name, reason, failure) in FAILURES.into_iter().chain(DRIVING_FAILURES) {
        let mut bench = observing(Bench::new());
        failure(&mut bench);
        let told = match reason {
            // A log has no path of ours that could end.
            Reason::ReferenceFinished => None,
            reason => Some(reason),
        };
        for _ in 0..2 {
            assert_eq!(observed(&mut bench, true), (false, told), "{name}");
        }
    }
}

#[test]
fn nothing_ends_a_drive_that_is_none() {
    for (name, _, failure) in FAILURES.into_iter().chain(DRIVING_FAILURES) {
        let mut bench = observing(Bench::new());
        failure(&mut bench);
        assert_eq!(observed(&mut bench, false), (false, None), "{name}");
    }
}

#[test]
fn a_board_that_no_log_tells_of_is_not_judged() {
    let mut bench = observing(Bench::unconnected(SupervisorConfig::paper()));
    // Long after the last status would have come.
    bench.conditions.now = Time(bench.conditions.now.0 + 5_000_000_000);
    assert_eq!(observed(&mut bench, true), (false, None));
    bench.conditions.overspeed = true;
    assert_eq!(observed(&mut bench, true), (false, Some(Reason::Overspeed)));
}

#[test]
fn a_pose_is_held_as_long_as_in_a_drive_of_ours() {
    let config = SupervisorConfig::paper();
    let mut bench = observing(Bench::new());
    bench.conditions.blind_distance = config.blind_distance;
    bench.pose_age_ms = 600;
    assert_eq!(observed(&mut bench, true), (false, None));
    bench.pose_age_ms = 601;
    let too_old = (false, Some(Reason::PoseTooOld));
    assert_eq!(observed(&mut bench, true), too_old);
}
