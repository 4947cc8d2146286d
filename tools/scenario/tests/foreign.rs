//! Controllers outside that misbehave: the car stops or is limited, inside its fence and with a
//! reason, and the drive can be replayed.

use singletrack_control::{
    Position, Setpoint, SetpointStamp, SpeedDemand, SteeringDemand, Time, Trajectory,
    TrajectoryPoint, Velocity, direction,
};
use singletrack_core::{
    config::{Config, FenceSection, OuterLoopSection, ReferenceSection},
    setpoint::SetpointCommand,
};
use singletrack_pilot::{Arming, Mode, PilotRequest, Reason};
use singletrack_record::{Entry, Replay};
use singletrack_scenario::{
    simulated::{BRAKING_M_S2, Drive, daemon_config},
    virtual_drive::VirtualDrive,
};
use singletrack_sim::{SimulationConfig, Truth};

/// The estimate's error at the side of the fence, in m.
const TOLERANCE: f64 = 0.005;

const TIMEOUT_NS: u64 = 200_000_000;

fn config() -> Config {
    let mut config = daemon_config(Drive::following(ReferenceSection::External {
        setpoint_timeout_ms: 200,
    }));
    config.outer_loop = OuterLoopSection::Proportional {
        gain_per_s: [1.0, 1.0],
        feed_forward: true,
    };
    config.fence = FenceSection {
        corners_m: vec![[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]],
        margin_m: Some(0.0),
        ..FenceSection::new(BRAKING_M_S2)
    };
    config
}

/// What the controller sends before the tick at `now`.
type Controller = fn(&VirtualDrive, Time, &Truth);

/// How a drive ended.
struct Ended {
    reason: Reason,
    /// From the last good set-point to the stop, ns.
    after_ns: u64,
    /// The largest speed, m/s.
    fastest: f64,
}

/// Drives at 0.3 m/s until the controller has driven for 1 s, then as `hostile` does.
fn drive(hostile: Controller) -> Ended {
    let config = config();
    let simulation = SimulationConfig::default();
    let mut drive = VirtualDrive::new(config.clone(), 3, simulation).unwrap();
    drive.keep_entries();
    let fence = config.fence.fence(&config.vehicle).unwrap();
    let mut driven = 0;
    let mut last_good = 0;
    let mut fastest = 0.0_f64;
    let mut reason = None;
    let mut truth = None;
    for _ in 0..3_000 {
        let now = Time(drive.now_us() * 1_000);
        match &truth {
            Some(truth) if driven > 100 => hostile(&drive, now, truth),
            _ => {
                last_good = now.0;
                let ahead = Velocity::new(0.3, 0.0);
                drive.send_setpoint(&Setpoint::point(now, None, ahead));
            }
        }
        if drive.mode() == Mode::Ready && driven == 0 {
            drive
                .request(PilotRequest::Arm(Arming::Unattended))
                .unwrap();
        }
        let tick = drive.step();
        let output = &tick.tick.output;
        let clearance = fence.clearance(&Position::new(tick.truth.x, tick.truth.y));
        assert!(clearance > -TOLERANCE, "{clearance} m: {output:?}");
        driven += u32::from(output.mode == Mode::Driving);
        fastest = fastest.max(tick.truth.speed);
        if driven > 100 && output.mode != Mode::Driving {
            let stopped = || (output.reason.unwrap(), tick.now.0);
            reason.get_or_insert_with(stopped);
            if tick.truth.speed.abs() < 0.01 {
                break;
            }
        }
        truth = Some(tick.truth);
    }
    let mut replay = Replay::new(config.pilot().unwrap());
    for entry in drive.entries() {
        if let Entry::Tick(tick) = entry {
            let output = replay.tick(&tick).unwrap();
            assert!(tick.is_output(&output), "{:?}", tick.differences(&output));
        }
    }
    let (reason, stopped_ns) = reason.unwrap();
    Ended {
        reason,
        after_ns: stopped_ns - last_good,
        fastest,
    }
}

/// A stop 200 ms after the last set-point that may be obeyed, and a tick.
fn assert_stale(hostile: Controller) {
    let ended = drive(hostile);
    assert_eq!(ended.reason, Reason::SetpointStale);
    let late = ended.after_ns.abs_diff(TIMEOUT_NS);
    assert!(late <= 20_000_000, "{late} ns");
}

#[test]
fn one_that_hangs_or_dies_ends_the_drive() {
    assert_stale(|_, _, _| {});
}

#[test]
fn numbers_that_are_none_end_the_drive() {
    assert_stale(|drive, now, _| {
        drive.send_setpoint(&Setpoint::point(now, None, Velocity::new(f64::NAN, 0.0)));
    });
    assert_stale(|drive, now, _| {
        drive.send_setpoint(&Setpoint::actuation(
            now,
            SteeringDemand::Angle(0.0),
            SpeedDemand::Acceleration(f64::INFINITY),
        ));
    });
}

#[test]
fn stamps_from_the_past_and_the_future_end_the_drive() {
    assert_stale(|drive, now, _| {
        let old = Time(now.0 - 1_000_000_000);
        drive.send_setpoint(&Setpoint::point(old, None, Velocity::new(0.3, 0.0)));
    });
    assert_stale(|drive, now, _| {
        let future = Time(now.0 + 1_000_000_000);
        drive.send_setpoint(&Setpoint::point(future, None, Velocity::new(0.3, 0.0)));
    });
}

/// Gives the pilot a trajectory of a program.
fn pass(drive: &VirtualDrive, now: Time, points: impl IntoIterator<Item = TrajectoryPoint>) {
    let trajectory = Trajectory {
        stamp: stamp(now),
        points: points.into_iter().collect(),
    };
    let command = SetpointCommand::Trajectory(Box::new(trajectory));
    drive.host().parts.setpoints.pass(&command);
}

#[test]
fn a_trajectory_that_is_repeated_after_its_end_ends_the_drive() {
    let ended = drive(|drive, now, truth| {
        let second = now.0 / 1_000_000_000 * 1_000_000_000;
        let points = [0, 900].map(|ms| TrajectoryPoint {
            time: Time(second + ms * 1_000_000),
            position: Position::new(truth.x, truth.y),
            velocity: Velocity::zeros(),
        });
        pass(drive, now, points);
    });
    assert_eq!(ended.reason, Reason::SetpointStale);
}

#[test]
fn a_thousand_set_points_a_tick_change_nothing() {
    let ended = drive(|drive, now, truth| {
        for number in 0..1_000 {
            let v_y = f64::from(number) * 1e-6;
            drive.send_setpoint(&Setpoint::point(now, None, Velocity::new(0.3, v_y)));
        }
        assert!(truth.speed < 0.5);
    });
    // Straight on to the fence.
    assert_eq!(ended.reason, Reason::OutsideFence);
}

#[test]
fn all_speed_straight_at_the_fence_stops_inside() {
    let ended = drive(|drive, now, _| {
        drive.send_setpoint(&Setpoint::actuation(
            now,
            SteeringDemand::Angle(0.0),
            SpeedDemand::Speed(100.0),
        ));
    });
    assert_eq!(ended.reason, Reason::OutsideFence);
    assert!(ended.fastest < config().limits.max_speed_m_s * 1.1);
    let ended = drive(|drive, now, truth| {
        let away = direction(libm::atan2(truth.y, truth.x));
        let points = (0..20).map(|index| {
            let seconds = 0.1 * f64::from(index);
            TrajectoryPoint {
                time: now.after(seconds),
                position: Position::new(truth.x, truth.y) + 50.0 * seconds * away,
                velocity: 50.0 * away,
            }
        });
        pass(drive, now, points);
    });
    assert_eq!(ended.reason, Reason::OutsideFence);
    assert!(ended.fastest < config().limits.max_speed_m_s * 1.1);
}

#[test]
fn full_steering_at_all_speed_by_turns_stops_inside() {
    let controllers: [Controller; 3] = [
        |drive, now, _| swing(drive, now, 300_000_000),
        |drive, now, _| swing(drive, now, 1_500_000_000),
        // To the last moment straight at the fence, then full steering.
        |drive, now, truth| {
            let steering = if truth.x.abs().max(truth.y.abs()) > 1.0 {
                1.5
            } else {
                0.0
            };
            drive.send_setpoint(&Setpoint::actuation(
                now,
                SteeringDemand::Angle(steering),
                SpeedDemand::Speed(100.0),
            ));
        },
    ];
    for controller in controllers {
        let ended = drive(controller);
        assert_ne!(ended.reason, Reason::SetpointStale);
        assert!(ended.fastest < config().limits.max_speed_m_s * 1.1);
    }
}

fn swing(drive: &VirtualDrive, now: Time, half_ns: u64) {
    let side = if (now.0 / half_ns).is_multiple_of(2) {
        100.0
    } else {
        -100.0
    };
    drive.send_setpoint(&Setpoint::actuation(
        now,
        SteeringDemand::Rate(side),
        SpeedDemand::Acceleration(100.0),
    ));
}

const fn stamp(time: Time) -> SetpointStamp {
    SetpointStamp {
        time,
        sequence: Some(1),
    }
}
