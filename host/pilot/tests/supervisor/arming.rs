//! What an arm request needs, and what ends it.

use singletrack_pilot::{
    Arming, BoardHealth, BoardRequest, BoardState, LinkState, Mode, PilotRequest, RealTimeState,
    Reason, Supervisor, SupervisorConfig,
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
            supervisor.handle_link(LinkState::VersionDiffers);
        }),
        (Reason::VersionDiffers, |supervisor| {
            supervisor.handle_link(LinkState::ConfigurationRefused);
        }),
        (Reason::ConfigurationRefused, |supervisor| {
            supervisor.handle_link(LinkState::Ready);
        }),
        (Reason::BoardBooting, |supervisor| {
            supervisor.handle_board(BoardState::Neutral);
        }),
        (Reason::BatteryUnknown, |supervisor| {
            supervisor.handle_health(HEALTHY);
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
    bench.supervisor.handle_real_time(RealTimeState {
        fifo: false,
        memory_locked: false,
    });
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
        bench.supervisor.handle_real_time(RealTimeState {
            fifo,
            memory_locked,
        });
        let refused = (!(fifo && memory_locked)).then_some(Reason::RealTimeRefused);
        assert_eq!(bench.step().1, refused);
    }
}

#[test]
fn arming_ends_on_refusal_timeout_disarm_and_emergency_stop() {
    let mut bench = Bench::arming();
    bench.supervisor.handle_arm_refused();
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
    bench.supervisor.handle_link(LinkState::Down);
    bench.step();
    assert_eq!(bench.supervisor.preflight(), Some(Reason::LinkDown));
}
