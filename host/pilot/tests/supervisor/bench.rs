//! A supervisor with its inputs, and the failures that it must find.

use singletrack_control::Time;
use singletrack_pilot::{
    Arming, BoardHealth, BoardRequest, BoardState, Conditions, Event, ImuVerdict, LineHealth,
    LinkState, Mode, PilotRequest, PoseMissing, RealTimeState, Reason, Supervisor,
    SupervisorConfig,
};

pub(crate) const TICK_NS: u64 = 10_000_000;
pub(crate) const HEALTHY: BoardHealth = BoardHealth {
    battery_mv: 7_400,
    stop_input_open: false,
    battery_open: false,
    imu_fault: false,
};

/// A supervisor and its inputs.
pub(crate) struct Bench {
    pub(crate) supervisor: Supervisor,
    pub(crate) conditions: Conditions,
    /// The status message of every tick, once the board is connected.
    pub(crate) health: Option<BoardHealth>,
    /// Age of the last accepted pose, in ms.
    pub(crate) pose_age_ms: u64,
    pub(crate) imu_age_ms: u64,
}

/// A failure: its description, its reason, and how to cause it.
pub(crate) type Failure = (&'static str, Reason, fn(&mut Bench));

/// Failures at any time.
pub(crate) const FAILURES: [Failure; 18] = [
    ("an open battery input", Reason::BatteryOpen, |bench| {
        bench.health = Some(BoardHealth {
            battery_open: true,
            ..HEALTHY
        });
    }),
    ("an IMU with an error", Reason::ImuFault, |bench| {
        let fault = BoardHealth {
            imu_fault: true,
            ..HEALTHY
        };
        bench.health = Some(fault);
        // The report of the next tick is the second in a row.
        bench.supervisor.handle(&Event::Health(fault));
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
        bench.supervisor.handle(&Event::Health(empty));
        bench.supervisor.handle(&Event::Health(empty));
    }),
    (
        "damaged frames from the board",
        Reason::LineNoisy,
        |bench| {
            bench.supervisor.handle(&Event::Line(LineHealth {
                to_host: Some(0.51),
                to_board: None,
            }));
        },
    ),
    ("damaged frames to the board", Reason::LineNoisy, |bench| {
        bench.supervisor.handle(&Event::Line(LineHealth {
            to_host: Some(0.0),
            to_board: Some(0.51),
        }));
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
            .handle(&Event::PoseMissing(PoseMissing::Untrustworthy));
    }),
    ("a long marker loss", Reason::PoseTooOld, |bench| {
        bench.pose_age_ms = 601;
    }),
    ("the geofence", Reason::OutsideFence, |bench| {
        bench.conditions.inside_fence = false;
    }),
    ("another body near", Reason::NeighbourNear, |bench| {
        bench.conditions.neighbours = Some(Reason::NeighbourNear);
    }),
    ("a late controller", Reason::DeadlineMissed, |bench| {
        bench.conditions.late = true;
    }),
    ("no set-points", Reason::SetpointStale, |bench| {
        bench.conditions.setpoint_stale = true;
    }),
];

/// Failures during a drive only.
pub(crate) const DRIVING_FAILURES: [Failure; 4] = [
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
pub(crate) const STANDING_FAILURES: [Failure; 10] = [
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
        bench.conditions.camera_speed = Some(0.03);
    }),
    ("an estimate that moves", Reason::Moving, |bench| {
        bench.conditions.speed = -0.11;
    }),
    ("an estimate that is no number", Reason::Moving, |bench| {
        bench.conditions.speed = f64::NAN;
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
    pub(crate) fn new() -> Self {
        let mut bench = Self::unconnected(SupervisorConfig::paper());
        bench.connect();
        bench
    }

    pub(crate) fn unconnected(config: SupervisorConfig) -> Self {
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
                neighbours: None,
                late: false,
                setpoint_stale: false,
                filter: None,
                reference_finished: false,
            },
            health: None,
            pose_age_ms: 10,
            imu_age_ms: 10,
        }
    }

    pub(crate) fn connect(&mut self) {
        self.supervisor.handle(&Event::RealTime(RealTimeState {
            fifo: false,
            memory_locked: false,
        }));
        self.supervisor.handle(&Event::Link(LinkState::Ready));
        self.supervisor.handle_board(BoardState::Neutral);
        self.health = Some(HEALTHY);
    }

    /// The inputs of the next tick.
    pub(crate) fn prepare(&mut self) {
        let now = Time(self.conditions.now.0 + TICK_NS);
        if let Some(health) = self.health {
            self.supervisor.handle(&Event::Health(health));
        }
        let ago = |ms: u64| {
            ms.checked_mul(1_000_000)
                .and_then(|ns| now.0.checked_sub(ns))
                .map(Time)
        };
        self.conditions.now = now;
        self.conditions.pose_time = ago(self.pose_age_ms);
        self.conditions.imu_time = ago(self.imu_age_ms);
    }

    pub(crate) fn step(&mut self) -> (Mode, Option<Reason>, Option<BoardRequest>) {
        self.prepare();
        let request = self.supervisor.step(&self.conditions);
        (self.supervisor.mode(), self.supervisor.reason(), request)
    }

    pub(crate) fn ask(
        &mut self,
        request: PilotRequest,
    ) -> (Mode, Option<Reason>, Option<BoardRequest>) {
        self.supervisor.handle(&Event::Request(request));
        self.step()
    }

    pub(crate) fn arming() -> Self {
        let mut bench = Self::new();
        assert_eq!(bench.step(), (Mode::Ready, None, None));
        assert_eq!(
            bench.ask(PilotRequest::Arm(Arming::Unattended)),
            (Mode::Arming, None, Some(BoardRequest::Arm))
        );
        bench
    }

    pub(crate) fn driving() -> Self {
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

    pub(crate) fn slowing() -> Self {
        let mut bench = Self::driving();
        bench.pose_age_ms = 301;
        assert_eq!(
            bench.step(),
            (Mode::Slowing, Some(Reason::PoseTooOld), None)
        );
        bench
    }

    /// After a drive that ended by request, with every condition good.
    pub(crate) fn driven() -> Self {
        let mut bench = Self::driving();
        bench.ask(PilotRequest::Disarm);
        bench.conditions = Self::new().conditions;
        assert_eq!(bench.step().2, Some(BoardRequest::Disarm));
        bench.supervisor.handle_board(BoardState::Neutral);
        assert_eq!(bench.step(), (Mode::Ready, Some(Reason::Requested), None));
        bench
    }

    /// Causes a failure and steps once.
    pub(crate) fn after(
        &mut self,
        failure: fn(&mut Self),
    ) -> (Mode, Option<Reason>, Option<BoardRequest>) {
        failure(self);
        self.step()
    }
}

pub(crate) fn battery(battery_mv: u16) -> Option<BoardHealth> {
    Some(BoardHealth {
        battery_mv,
        ..HEALTHY
    })
}

/// Steps for this long, in ms; returns the last result.
pub(crate) fn steps(bench: &mut Bench, ms: u64) -> (Mode, Option<Reason>, Option<BoardRequest>) {
    let mut last = bench.step();
    for _ in 1..ms / 10 {
        last = bench.step();
    }
    last
}
