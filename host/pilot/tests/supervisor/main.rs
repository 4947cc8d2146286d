//! The supervisor alone: the conditions that refuse, slow down and end a drive.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

mod arming;
mod bench;
mod faults;
mod jogging;
mod stopping;

use singletrack_pilot::{
    Arming, BoardRequest, BoardState, Event, LineHealth, LinkState, Mode, PilotRequest, Reason,
    SupervisorConfig,
};

use bench::{Bench, DRIVING_FAILURES, FAILURES, HEALTHY, STANDING_FAILURES, battery};

#[test]
fn every_failure_refuses_a_drive_with_its_reason() {
    for (name, reason, failure) in FAILURES.into_iter().chain(STANDING_FAILURES) {
        let mut bench = Bench::new();
        assert_eq!(
            bench.after(failure),
            (Mode::Idle, Some(reason), None),
            "{name}"
        );
        assert_eq!(
            bench.ask(PilotRequest::Arm(Arming::Unattended)),
            (Mode::Idle, Some(reason), None),
            "{name}: asked to arm"
        );
    }
}

#[test]
fn every_failure_while_the_board_arms_disarms_it() {
    for (name, reason, failure) in FAILURES {
        let mut bench = Bench::arming();
        assert_eq!(
            bench.after(failure),
            (Mode::Idle, Some(reason), Some(BoardRequest::Disarm)),
            "{name}"
        );
    }
}

#[test]
fn every_failure_stops_a_drive_with_its_reason_and_for_good() {
    let failures = FAILURES.into_iter().chain(DRIVING_FAILURES);
    for (name, reason, failure) in failures {
        for mut bench in [Bench::driving(), Bench::slowing()] {
            assert_eq!(
                bench.after(failure),
                (Mode::Stopping, Some(reason), None),
                "{name}"
            );
            // The failure is gone: the car stops all the same, and stays stopped.
            bench.connect();
            bench.supervisor.handle_board(BoardState::Driving);
            bench.supervisor.handle(&Event::Line(LineHealth {
                to_host: None,
                to_board: None,
            }));
            bench.supervisor.handle_pose();
            bench.conditions = Bench::new().conditions;
            bench.conditions.commanded_speed = 0.3;
            (bench.pose_age_ms, bench.imu_age_ms) = (10, 10);
            assert_eq!(bench.step().0, Mode::Stopping, "{name}");
            bench.conditions.commanded_speed = 0.0;
            assert_eq!(
                bench.step(),
                (Mode::Idle, Some(reason), Some(BoardRequest::Disarm)),
                "{name}"
            );
            bench.supervisor.handle_board(BoardState::Neutral);
            for _ in 0..100 {
                assert_eq!(bench.step(), (Mode::Ready, Some(reason), None), "{name}");
            }
        }
    }
}

#[test]
fn a_noisy_estimate_of_a_standing_car_does_not_refuse_a_drive() {
    let mut bench = Bench::new();
    for speed in [-0.09, 0.05, 0.031, 0.09] {
        bench.conditions.speed = speed;
        bench.conditions.camera_speed = Some(0.01);
        assert_eq!(bench.step(), (Mode::Ready, None, None), "{speed} m/s");
    }
    // Without a speed from the cameras the estimate decides.
    bench.conditions.camera_speed = None;
    bench.conditions.speed = 0.031;
    assert_eq!(bench.step(), (Mode::Idle, Some(Reason::Moving), None));
    for camera_speed in [0.031, f64::NAN] {
        bench.conditions.speed = 0.0;
        bench.conditions.camera_speed = Some(camera_speed);
        assert_eq!(bench.step(), (Mode::Idle, Some(Reason::Moving), None));
    }
}

#[test]
fn the_reason_of_a_stop_stays_only_while_the_car_settles() {
    for (name, reason, failure) in FAILURES.into_iter().chain(STANDING_FAILURES) {
        let mut bench = Bench::driven();
        let settles = matches!(
            reason,
            Reason::Moving | Reason::ImuNotStill | Reason::EstimateUnsettled | Reason::BoardArmed
        );
        let shown = if settles { Reason::Requested } else { reason };
        assert_eq!(
            bench.after(failure),
            (Mode::Idle, Some(shown), None),
            "{name}"
        );
        // An arm request is answered with the present reason.
        assert_eq!(
            bench.ask(PilotRequest::Arm(Arming::Unattended)),
            (Mode::Idle, Some(reason), None),
            "{name}"
        );
    }
}

#[test]
fn a_lost_link_clears_the_state_of_the_board() {
    let mut bench = Bench::new();
    bench.supervisor.handle(&Event::Line(LineHealth {
        to_host: Some(0.9),
        to_board: Some(0.9),
    }));
    assert_eq!(bench.step().1, Some(Reason::LineNoisy));
    bench.health = None;
    bench.supervisor.handle(&Event::Link(LinkState::Down));
    assert_eq!(bench.step().0, Mode::Disconnected);
    bench.supervisor.handle(&Event::Link(LinkState::Ready));
    assert_eq!(bench.step().1, Some(Reason::BoardBooting));
    bench.supervisor.handle_board(BoardState::Neutral);
    assert_eq!(bench.step().1, Some(Reason::BatteryUnknown));
    bench.supervisor.handle(&Event::Health(HEALTHY));
    assert_eq!(bench.step(), (Mode::Ready, None, None));
}

#[test]
fn a_repeated_ready_keeps_the_state_of_the_board() {
    let mut bench = Bench::driving();
    bench.supervisor.handle(&Event::Link(LinkState::Ready));
    assert_eq!(bench.step(), (Mode::Driving, None, None));
}

#[test]
fn a_board_without_status_messages_ends_the_drive_after_a_second() {
    let mut bench = Bench::driving();
    bench.health = None;
    for tick in 0..100 {
        assert_eq!(bench.step().0, Mode::Driving, "{tick}");
    }
    assert_eq!(
        bench.step(),
        (Mode::Stopping, Some(Reason::BatteryUnknown), None)
    );
}

#[test]
fn a_battery_that_sags_for_two_reports_does_not_end_the_drive() {
    let mut bench = Bench::driving();
    for battery_mv in [6_399, 6_399, 6_400, 6_399, 6_399] {
        bench.health = battery(battery_mv);
        assert_eq!(bench.step().0, Mode::Driving);
    }
    assert_eq!(
        bench.step(),
        (Mode::Stopping, Some(Reason::BatteryLow), None)
    );
}

#[test]
fn battery_and_line_at_their_limits_pass() {
    let mut bench = Bench::new();
    bench.health = battery(6_800);
    bench.supervisor.handle(&Event::Line(LineHealth {
        to_host: Some(0.5),
        to_board: Some(0.5),
    }));
    assert_eq!(bench.step().0, Mode::Ready);
    let mut bench = Bench::driving();
    bench.health = battery(6_400);
    for _ in 0..10 {
        assert_eq!(bench.step().0, Mode::Driving);
    }
}

#[test]
fn new_limits_hold_from_the_next_tick_on() {
    let mut bench = Bench::new();
    bench.pose_age_ms = 60;
    assert_eq!(bench.step().1, Some(Reason::PoseTooOld));
    bench.supervisor.reconfigure(SupervisorConfig {
        fresh: 0.1,
        ..SupervisorConfig::paper()
    });
    assert_eq!(bench.step(), (Mode::Ready, None, None));
}

/// Readers of status, log and record depend on these words.
#[test]
fn the_words_for_the_modes_do_not_change() {
    assert_eq!(
        Mode::ALL.map(Mode::name),
        [
            "disconnected",
            "idle",
            "ready",
            "arming",
            "driving",
            "slowing",
            "stopping",
            "fault",
            "jogging",
        ]
    );
}

#[test]
fn modes_and_reasons_are_consistent_with_their_words() {
    let underway = [
        Mode::Arming,
        Mode::Driving,
        Mode::Slowing,
        Mode::Stopping,
        Mode::Jogging,
    ];
    for mode in Mode::ALL {
        assert_eq!(mode.is_underway(), underway.contains(&mode));
        assert_eq!(mode.commands(), underway[1..].contains(&mode));
        assert_eq!(mode.to_string(), mode.name());
    }
    for (index, reason) in Reason::ALL.iter().enumerate() {
        assert_eq!(reason.to_string(), reason.name());
        let same = |other: &Reason| other.name() == reason.name();
        assert_eq!(Reason::ALL.iter().position(same), Some(index));
    }
}
