//! The supervisor alone: the conditions that refuse, slow down and end a drive.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use singletrack_control::Time;
use singletrack_pilot::{
    BoardHealth, BoardRequest, BoardState, Conditions, ImuVerdict, LineHealth, LinkState, Mode,
    PilotRequest, PoseMissing, RealTimeState, Reason, Supervisor, SupervisorConfig,
};

const TICK_NS: u64 = 10_000_000;
const HEALTHY: BoardHealth = BoardHealth {
    battery_mv: 7_400,
    stop_input_open: false,
    battery_open: false,
    imu_fault: false,
};

/// A supervisor and its inputs.
struct Bench {
    supervisor: Supervisor,
    conditions: Conditions,
    /// The status message of every tick, once the board is connected.
    health: Option<BoardHealth>,
    /// Age of the last accepted pose, in ms.
    pose_age_ms: u64,
    imu_age_ms: u64,
}

/// A failure: its description, its reason, and how to cause it.
type Failure = (&'static str, Reason, fn(&mut Bench));

/// Failures at any time.
const FAILURES: [Failure; 17] = [
    ("an open battery input", Reason::BatteryOpen, |bench| {
        bench.health = Some(BoardHealth {
            battery_open: true,
            ..HEALTHY
        });
    }),
    ("an IMU with an error", Reason::ImuFault, |bench| {
        bench.health = Some(BoardHealth {
            imu_fault: true,
            ..HEALTHY
        });
    }),
    ("an open stop switch", Reason::StopInputOpen, |bench| {
        bench.health = Some(BoardHealth {
            stop_input_open: true,
            ..HEALTHY
        });
    }),
    ("an empty battery", Reason::BatteryLow, |bench| {
        let empty = BoardHealth {
            battery_mv: 6_399,
            ..HEALTHY
        };
        bench.health = Some(empty);
        // The report of the next tick is the third in a row.
        bench.supervisor.handle_health(empty);
        bench.supervisor.handle_health(empty);
    }),
    (
        "damaged frames from the board",
        Reason::LineNoisy,
        |bench| {
            bench.supervisor.handle_line(LineHealth {
                to_host: Some(0.51),
                to_board: None,
            });
        },
    ),
    ("damaged frames to the board", Reason::LineNoisy, |bench| {
        bench.supervisor.handle_line(LineHealth {
            to_host: Some(0.0),
            to_board: Some(0.51),
        });
    }),
    ("a silent IMU", Reason::ImuSilent, |bench| {
        bench.imu_age_ms = 101;
    }),
    ("an IMU without a sample", Reason::ImuSilent, |bench| {
        bench.conditions.imu_time = None;
        bench.imu_age_ms = u64::MAX;
    }),
    ("an IMU that repeats itself", Reason::ImuStuck, |bench| {
        bench.conditions.imu = ImuVerdict::Stuck;
    }),
    ("an implausible IMU", Reason::ImuImplausible, |bench| {
        bench.conditions.imu = ImuVerdict::Implausible;
    }),
    ("no pose", Reason::NoPose, |bench| {
        bench.pose_age_ms = u64::MAX;
    }),
    ("implausible poses", Reason::PoseImplausible, |bench| {
        bench.conditions.implausible = 20;
    }),
    ("untrustworthy cameras", Reason::PoseImplausible, |bench| {
        bench
            .supervisor
            .handle_pose_missing(PoseMissing::Untrustworthy);
    }),
    ("a long marker loss", Reason::PoseTooOld, |bench| {
        bench.pose_age_ms = 601;
    }),
    ("the geofence", Reason::OutsideFence, |bench| {
        bench.conditions.inside_fence = false;
    }),
    ("a late controller", Reason::DeadlineMissed, |bench| {
        bench.conditions.late = true;
    }),
    ("no set-points", Reason::SetpointStale, |bench| {
        bench.conditions.setpoint_stale = true;
    }),
];

/// Failures during a drive only.
const DRIVING_FAILURES: [Failure; 4] = [
    (
        "motor pulses of another speed",
        Reason::MotorSpeedMismatch,
        |bench| {
            bench.conditions.speed_mismatch = true;
        },
    ),
    ("overspeed", Reason::Overspeed, |bench| {
        bench.conditions.overspeed = true;
    }),
    (
        "the end of the reference",
        Reason::ReferenceFinished,
        |bench| {
            bench.conditions.reference_finished = true;
        },
    ),
    (
        "a long distance without a pose",
        Reason::BlindTooFar,
        |bench| {
            bench.conditions.blind_distance = 0.451;
        },
    ),
];

/// Failures before a drive only.
const STANDING_FAILURES: [Failure; 8] = [
    (
        "a battery below the arming limit",
        Reason::BatteryLow,
        |bench| {
            bench.health = Some(BoardHealth {
                battery_mv: 6_799,
                ..HEALTHY
            });
        },
    ),
    ("a pose that is not fresh", Reason::PoseTooOld, |bench| {
        bench.pose_age_ms = 51;
    }),
    (
        "a filter with too few poses",
        Reason::EstimateUnsettled,
        |bench| {
            bench.conditions.poses = 49;
        },
    ),
    ("a car that moves", Reason::Moving, |bench| {
        bench.conditions.speed = -0.03;
    }),
    ("wheels that turn", Reason::Moving, |bench| {
        bench.conditions.motor_speed = -0.03;
    }),
    ("a car that is shaken", Reason::ImuNotStill, |bench| {
        bench.conditions.imu_still = false;
    }),
    ("a board that starts up", Reason::BoardBooting, |bench| {
        bench.supervisor.handle_board(BoardState::Booting);
    }),
    ("a board that is armed", Reason::BoardArmed, |bench| {
        bench.supervisor.handle_board(BoardState::Driving);
    }),
];

impl Bench {
    /// Connected, with every condition good.
    fn new() -> Self {
        let mut bench = Self::unconnected(SupervisorConfig::paper());
        bench.connect();
        bench
    }

    fn unconnected(config: SupervisorConfig) -> Self {
        Self {
            supervisor: Supervisor::new(config),
            conditions: Conditions {
                now: Time(10_000_000_000),
                pose_time: None,
                blind_distance: 0.0,
                poses: 50,
                implausible: 19,
                imu_time: None,
                imu: ImuVerdict::Good,
                imu_still: true,
                speed: 0.029,
                motor_speed: 0.029,
                camera_speed: Some(0.029),
                stands: true,
                preflight: None,
                doubt: None,
                implausible_motion: None,
                contradiction: None,
                speed_mismatch: false,
                overspeed: false,
                commanded_speed: 0.0,
                inside_fence: true,
                late: false,
                setpoint_stale: false,
                reference_finished: false,
            },
            health: None,
            pose_age_ms: 10,
            imu_age_ms: 10,
        }
    }

    fn connect(&mut self) {
        self.supervisor.handle_real_time(RealTimeState {
            fifo: false,
            memory_locked: false,
        });
        self.supervisor.handle_link(LinkState::Ready);
        self.supervisor.handle_board(BoardState::Neutral);
        self.health = Some(HEALTHY);
    }

    fn step(&mut self) -> (Mode, Option<Reason>, Option<BoardRequest>) {
        let now = Time(self.conditions.now.0 + TICK_NS);
        if let Some(health) = self.health {
            self.supervisor.handle_health(health);
        }
        let ago = |ms: u64| {
            ms.checked_mul(1_000_000)
                .and_then(|ns| now.0.checked_sub(ns))
                .map(Time)
        };
        self.conditions.now = now;
        self.conditions.pose_time = ago(self.pose_age_ms);
        self.conditions.imu_time = ago(self.imu_age_ms);
        let request = self.supervisor.step(&self.conditions);
        (self.supervisor.mode(), self.supervisor.reason(), request)
    }

    fn ask(&mut self, request: PilotRequest) -> (Mode, Option<Reason>, Option<BoardRequest>) {
        self.supervisor.handle_request(request);
        self.step()
    }

    fn arming() -> Self {
        let mut bench = Self::new();
        assert_eq!(bench.step(), (Mode::Ready, None, None));
        assert_eq!(
            bench.ask(PilotRequest::Arm),
            (Mode::Arming, None, Some(BoardRequest::Arm))
        );
        bench
    }

    fn driving() -> Self {
        let mut bench = Self::arming();
        bench.supervisor.handle_board(BoardState::Armed);
        assert_eq!(bench.step(), (Mode::Driving, None, None));
        bench.supervisor.handle_board(BoardState::Driving);
        bench.conditions.commanded_speed = 0.5;
        bench.conditions.speed = 0.5;
        bench.conditions.motor_speed = 0.5;
        // It would refuse a drive, and does not end one.
        bench.conditions.imu_still = false;
        assert_eq!(bench.step(), (Mode::Driving, None, None));
        bench
    }

    fn slowing() -> Self {
        let mut bench = Self::driving();
        bench.pose_age_ms = 301;
        assert_eq!(
            bench.step(),
            (Mode::Slowing, Some(Reason::PoseTooOld), None)
        );
        bench
    }

    /// After a drive that ended by request, with every condition good.
    fn driven() -> Self {
        let mut bench = Self::driving();
        bench.ask(PilotRequest::Disarm);
        bench.conditions = Self::new().conditions;
        assert_eq!(bench.step().2, Some(BoardRequest::Disarm));
        bench.supervisor.handle_board(BoardState::Neutral);
        assert_eq!(bench.step(), (Mode::Ready, Some(Reason::Requested), None));
        bench
    }

    /// Causes a failure and steps once.
    fn after(&mut self, failure: fn(&mut Self)) -> (Mode, Option<Reason>, Option<BoardRequest>) {
        failure(self);
        self.step()
    }
}

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
            bench.ask(PilotRequest::Arm),
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
            bench.supervisor.handle_line(LineHealth {
                to_host: None,
                to_board: None,
            });
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
            bench.ask(PilotRequest::Arm),
            (Mode::Idle, Some(reason), None),
            "{name}"
        );
    }
}

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
        let (mode, shown, request) = bench.ask(PilotRequest::Arm);
        assert_eq!((shown, request), (Some(reason), None));
        assert!(matches!(mode, Mode::Disconnected | Mode::Idle));
        give(&mut bench.supervisor);
    }
    assert_eq!(
        bench.ask(PilotRequest::Arm).1,
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
fn a_lost_link_clears_the_state_of_the_board() {
    let mut bench = Bench::new();
    bench.supervisor.handle_line(LineHealth {
        to_host: Some(0.9),
        to_board: Some(0.9),
    });
    assert_eq!(bench.step().1, Some(Reason::LineNoisy));
    bench.health = None;
    bench.supervisor.handle_link(LinkState::Down);
    assert_eq!(bench.step().0, Mode::Disconnected);
    bench.supervisor.handle_link(LinkState::Ready);
    assert_eq!(bench.step().1, Some(Reason::BoardBooting));
    bench.supervisor.handle_board(BoardState::Neutral);
    assert_eq!(bench.step().1, Some(Reason::BatteryUnknown));
    bench.supervisor.handle_health(HEALTHY);
    assert_eq!(bench.step(), (Mode::Ready, None, None));
}

#[test]
fn a_repeated_ready_keeps_the_state_of_the_board() {
    let mut bench = Bench::driving();
    bench.supervisor.handle_link(LinkState::Ready);
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

fn battery(battery_mv: u16) -> Option<BoardHealth> {
    Some(BoardHealth {
        battery_mv,
        ..HEALTHY
    })
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
    bench.supervisor.handle_line(LineHealth {
        to_host: Some(0.5),
        to_board: Some(0.5),
    });
    assert_eq!(bench.step().0, Mode::Ready);
    let mut bench = Bench::driving();
    bench.health = battery(6_400);
    for _ in 0..10 {
        assert_eq!(bench.step().0, Mode::Driving);
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

#[test]
fn an_earlier_emergency_stop_does_not_clear_a_fault_of_the_law() {
    let mut bench = Bench::driving();
    bench.ask(PilotRequest::EmergencyStop);
    bench.supervisor.handle_board(BoardState::EmergencyStopped);
    assert_eq!(bench.step().0, Mode::Fault);
    bench.supervisor.handle_board(BoardState::Neutral);
    bench.conditions = Bench::new().conditions;
    bench.step();
    bench.ask(PilotRequest::Arm);
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
    bench.supervisor.handle_link(LinkState::EmergencyStopped);
    assert_eq!(
        bench.step(),
        (Mode::Disconnected, Some(Reason::EmergencyStop), None)
    );
}

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
            "fault"
        ]
    );
}

#[test]
fn modes_and_reasons_are_consistent_with_their_words() {
    let underway = [Mode::Arming, Mode::Driving, Mode::Slowing, Mode::Stopping];
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

/// Steps for this long, in ms; returns the last result.
fn steps(bench: &mut Bench, ms: u64) -> (Mode, Option<Reason>, Option<BoardRequest>) {
    let mut last = bench.step();
    for _ in 1..ms / 10 {
        last = bench.step();
    }
    last
}

#[test]
fn a_held_drive_ends_half_a_second_after_its_last_renewal() {
    let mut bench = Bench::new();
    bench.step();
    assert_eq!(bench.ask(PilotRequest::ArmHeld).0, Mode::Arming);
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
    assert_eq!(bench.ask(PilotRequest::ArmHeld).0, Mode::Arming);
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
        bench.supervisor.handle_request(PilotRequest::ArmHeld);
        assert_eq!(bench.ask(request).0, Mode::Ready);
        bench.supervisor.fault(Reason::LawSingular, Time(0));
        assert_eq!(bench.ask(request).0, Mode::Fault);
        assert_eq!(bench.ask(PilotRequest::Disarm).0, Mode::Idle);
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
    let motor: fn(&mut Bench) = |bench| bench.conditions.motor_speed = 0.3;
    let estimate: fn(&mut Bench) = |bench| bench.conditions.speed = -0.3;
    let no_number: fn(&mut Bench) = |bench| bench.conditions.motor_speed = f64::NAN;
    for moves in [motor, estimate, no_number] {
        let mut bench = Bench::arming();
        bench.supervisor.handle_board(BoardState::PoweringUp);
        assert_eq!(bench.step().0, Mode::Arming);
        let disarm = Some(BoardRequest::Disarm);
        assert_eq!(
            bench.after(moves),
            (Mode::Idle, Some(Reason::Moving), disarm)
        );
    }
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
        bench.ask(PilotRequest::Arm),
        (Mode::Idle, Some(Reason::RunsAtNeutral), None)
    );
}

#[test]
fn the_arming_check_never_shows_why_the_last_drive_ended() {
    let mut bench = Bench::driven();
    assert_eq!(bench.supervisor.preflight(), None);
    bench.conditions.imu_still = false;
    assert_eq!(bench.step().1, Some(Reason::Requested));
    assert_eq!(bench.supervisor.preflight(), Some(Reason::ImuNotStill));
    bench.conditions.imu_still = true;
    bench.ask(PilotRequest::Arm);
    assert_eq!(bench.supervisor.preflight(), None);
    bench.supervisor.handle_link(LinkState::Down);
    bench.step();
    assert_eq!(bench.supervisor.preflight(), Some(Reason::LinkDown));
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
            PilotRequest::Arm,
            PilotRequest::ArmHeld,
            PilotRequest::TimeUp,
            PilotRequest::Arm,
        ] {
            assert_eq!(bench.ask(request), (Mode::Idle, Some(reason), None));
            assert_eq!(bench.supervisor.preflight(), Some(reason));
        }
        assert_eq!(bench.ask(PilotRequest::Disarm).0, Mode::Ready);
        assert_eq!(bench.ask(PilotRequest::Arm).0, Mode::Arming);
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
    bench.supervisor.handle_link(LinkState::Down);
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
        (0.031, Some(0.0), false),
        (0.0, Some(0.031), false),
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
