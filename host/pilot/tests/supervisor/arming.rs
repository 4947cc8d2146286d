//! What an arm request needs, and what ends it; held, timed and unattended drives.

use singletrack_control::Time;
use singletrack_pilot::{
    Arming, BoardHealth, BoardRequest, BoardState, Event, LinkState, Mode, PilotRequest,
    RealTimeState, Reason, Supervisor, SupervisorConfig,
};

use crate::bench::{Bench, HEALTHY, STANDING_FAILURES, battery, steps};

#[test]
fn failures_of_the_arming_check_alone_do_not_end_a_drive() {
    for (name, _, failure) in STANDING_FAILURES {
        if name.starts_with("a board") {
            continue;
        }
        let mut bench = Bench::driving();
        assert_eq!(bench.after(failure), (Mode::Driving, None, None), "{name}");
    }
}

#[test]
fn arming_needs_every_input_once() {
    type Input = (Reason, fn(&mut Supervisor));
    let mut bench = Bench::unconnected(SupervisorConfig::paper());
    let inputs: [Input; 5] = [
        (Reason::LinkDown, |supervisor| {
            supervisor.handle(&Event::Link(LinkState::VersionDiffers));
        }),
        (Reason::VersionDiffers, |supervisor| {
            supervisor.handle(&Event::Link(LinkState::ConfigurationRefused));
        }),
        (Reason::ConfigurationRefused, |supervisor| {
            supervisor.handle(&Event::Link(LinkState::Ready));
        }),
        (Reason::BoardBooting, |supervisor| {
            supervisor.handle_board(BoardState::Neutral);
        }),
        (Reason::BatteryUnknown, |supervisor| {
            supervisor.handle(&Event::Health(HEALTHY));
        }),
    ];
    for (reason, give) in inputs {
        let (mode, shown, request) = bench.ask(PilotRequest::Arm(Arming::Unattended));
        assert_eq!((shown, request), (Some(reason), None));
        assert!(matches!(mode, Mode::Disconnected | Mode::Idle));
        give(&mut bench.supervisor);
    }
    assert_eq!(
        bench.ask(PilotRequest::Arm(Arming::Unattended)).1,
        Some(Reason::RealTimeUnknown)
    );
    bench.supervisor.handle(&Event::RealTime(RealTimeState {
        fifo: false,
        memory_locked: false,
    }));
    assert_eq!(bench.step(), (Mode::Ready, None, None));
}

#[test]
fn real_time_is_required_only_if_the_configuration_requires_it() {
    for (fifo, memory_locked) in [(false, false), (true, false), (false, true), (true, true)] {
        let mut bench = Bench::unconnected(SupervisorConfig {
            require_real_time: true,
            ..SupervisorConfig::paper()
        });
        bench.connect();
        bench.supervisor.handle(&Event::RealTime(RealTimeState {
            fifo,
            memory_locked,
        }));
        let refused = (!(fifo && memory_locked)).then_some(Reason::RealTimeRefused);
        assert_eq!(bench.step().1, refused);
    }
}

#[test]
fn arming_ends_on_refusal_timeout_disarm_and_emergency_stop() {
    let mut bench = Bench::arming();
    bench.supervisor.handle(&Event::ArmRefused);
    assert_eq!(
        bench.step(),
        (
            Mode::Idle,
            Some(Reason::BoardRefused),
            Some(BoardRequest::Disarm)
        )
    );
    let mut bench = Bench::arming();
    for _ in 0..50 {
        assert_eq!(bench.step(), (Mode::Arming, None, None));
    }
    assert_eq!(
        bench.step(),
        (
            Mode::Idle,
            Some(Reason::BoardTimeout),
            Some(BoardRequest::Disarm)
        )
    );
    assert_eq!(
        Bench::arming().ask(PilotRequest::Disarm),
        (
            Mode::Idle,
            Some(Reason::Requested),
            Some(BoardRequest::Disarm)
        )
    );
    let mut bench = Bench::arming();
    bench.supervisor.handle_board(BoardState::EmergencyStopped);
    assert_eq!(
        bench.step(),
        (Mode::Fault, Some(Reason::EmergencyStop), None)
    );
}

#[test]
fn limits_of_zero_disable_the_check_of_the_battery() {
    let mut bench = Bench::unconnected(SupervisorConfig {
        min_battery: 0.0,
        arm_battery: 0.0,
        ..SupervisorConfig::paper()
    });
    bench.connect();
    bench.health = battery(0);
    for _ in 0..10 {
        assert_eq!(bench.step().0, Mode::Ready);
    }
}

#[test]
fn an_open_battery_input_refuses_to_arm_unless_both_limits_are_zero() {
    for (min_battery, arm_battery, refused) in
        [(6.4, 6.8, true), (0.0, 6.8, true), (0.0, 0.0, false)]
    {
        let mut bench = Bench::unconnected(SupervisorConfig {
            min_battery,
            arm_battery,
            ..SupervisorConfig::paper()
        });
        bench.connect();
        bench.health = Some(BoardHealth {
            battery_mv: 0,
            battery_open: true,
            ..HEALTHY
        });
        let (mode, reason, _) = bench.step();
        let expected = if refused {
            (Mode::Idle, Some(Reason::BatteryOpen))
        } else {
            (Mode::Ready, None)
        };
        assert_eq!((mode, reason), expected, "{min_battery}, {arm_battery}");
    }
}

#[test]
fn a_board_that_switches_the_supply_on_has_more_time_and_is_not_driving_yet() {
    let mut bench = Bench::arming();
    bench.supervisor.handle_board(BoardState::PoweringUp);
    assert_eq!(steps(&mut bench, 2_000).0, Mode::Arming);
    bench.supervisor.handle_board(BoardState::Armed);
    assert_eq!(bench.step().0, Mode::Driving);

    let mut bench = Bench::arming();
    bench.supervisor.handle_board(BoardState::PoweringUp);
    assert_eq!(steps(&mut bench, 3_000).0, Mode::Arming);
    assert_eq!(
        bench.step(),
        (
            Mode::Idle,
            Some(Reason::BoardTimeout),
            Some(BoardRequest::Disarm)
        )
    );
    bench.step();
    assert_eq!(bench.supervisor.preflight(), Some(Reason::BoardArmed));
}

#[test]
fn a_car_that_moves_while_its_board_arms_is_disarmed() {
    let motor: fn(&mut Bench) = |bench| bench.conditions.motor_speed = 0.101;
    let estimate: fn(&mut Bench) = |bench| bench.conditions.speed = -0.101;
    let no_number: fn(&mut Bench) = |bench| bench.conditions.motor_speed = f64::NAN;
    for moves in [motor, estimate, no_number] {
        let mut bench = Bench::arming();
        bench.supervisor.handle_board(BoardState::PoweringUp);
        // Noise and a first pulse.
        (bench.conditions.motor_speed, bench.conditions.speed) = (-0.1, 0.1);
        assert_eq!(bench.step().0, Mode::Arming);
        let disarm = Some(BoardRequest::Disarm);
        assert_eq!(
            bench.after(moves),
            (Mode::Idle, Some(Reason::Moving), disarm)
        );
    }
}

#[test]
fn the_arming_check_never_shows_why_the_last_drive_ended() {
    let mut bench = Bench::driven();
    assert_eq!(bench.supervisor.preflight(), None);
    bench.conditions.imu_still = false;
    assert_eq!(bench.step().1, Some(Reason::Requested));
    assert_eq!(bench.supervisor.preflight(), Some(Reason::ImuNotStill));
    bench.conditions.imu_still = true;
    bench.ask(PilotRequest::Arm(Arming::Unattended));
    assert_eq!(bench.supervisor.preflight(), None);
    bench.supervisor.handle(&Event::Link(LinkState::Down));
    bench.step();
    assert_eq!(bench.supervisor.preflight(), Some(Reason::LinkDown));
}

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
        .handle(&Event::Request(PilotRequest::Arm(Arming::Held)));
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
            .handle(&Event::Request(PilotRequest::Arm(Arming::Held)));
        assert_eq!(bench.ask(request).0, Mode::Ready);
        bench.supervisor.fault(Reason::LawSingular, Time(0));
        assert_eq!(bench.ask(request).0, Mode::Fault);
        assert_eq!(bench.ask(PilotRequest::Disarm).0, Mode::Idle);
    }
}
