//! Set-points from outside, by the pilot on an ideal car.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail")]

use singletrack_control::{
    External, Position, ProportionalLoop, Reference, Setpoint, SetpointStamp, SpeedDemand,
    SteeringDemand, Time, TrackingLoop, Trajectory, TrajectoryPoint, Velocity,
};
use singletrack_pilot::{Arming, Event, Mode, PilotConfig, PilotRequest, Reason, SetpointRefusal};

use crate::bench::{Bench, TICK_NS, config};

fn setpoint(bench: &Bench, velocity: Velocity, position: Option<Position>) -> Event {
    let now = Time((bench.tick + 1) * TICK_NS);
    Event::Setpoint(Setpoint::point(now, position, velocity))
}

#[test]
fn external_set_points_are_followed_until_the_last_one_is_too_old() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        ..config()
    });
    let output = bench.run(100);
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Idle, Some(Reason::SetpointStale))
    );
    let mut outputs = Vec::new();
    for tick in 0..200 {
        if tick == 10 {
            bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let event = setpoint(&bench, Velocity::new(0.5, 0.0), None);
        bench.extra.push(event);
        outputs.push(bench.step());
    }
    let last = outputs.last().unwrap();
    assert_eq!((last.mode, last.reason), (Mode::Driving, None));
    assert_eq!(last.point_velocity, Some(Velocity::new(0.5, 0.0)));
    assert!((bench.speed - 0.5).abs() < 0.01);
    // A set-point with a NaN is ignored.
    for _ in 0..20 {
        let event = setpoint(&bench, Velocity::new(f64::NAN, 0.0), None);
        bench.extra.push(event);
        let output = bench.step();
        assert_eq!(output.mode, Mode::Driving);
        assert_eq!(output.setpoint_refused, Some(SetpointRefusal::NotFinite));
    }
    let output = bench.step();
    assert_eq!(output.setpoint_refused, None);
    assert_eq!(
        (output.mode, output.reason),
        (Mode::Stopping, Some(Reason::SetpointStale))
    );
}

#[test]
fn a_set_point_that_is_not_obeyed_shows_in_the_tick_with_the_reason() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        ..config()
    });
    bench.run(100);
    let now = (bench.tick + 1) * TICK_NS;
    let at = |ns| Event::Setpoint(Setpoint::point(Time(ns), None, Velocity::zeros()));
    let mut refused = |events: &[Event]| {
        bench.extra.extend_from_slice(events);
        bench.step().setpoint_refused
    };
    assert_eq!(refused(&[at(now)]), None);
    assert_eq!(refused(&[at(now - 1)]), Some(SetpointRefusal::Superseded));
    assert_eq!(refused(&[at(0)]), Some(SetpointRefusal::Old));
    assert_eq!(refused(&[at(u64::MAX)]), Some(SetpointRefusal::Future));
    // A later one that is obeyed does not hide it.
    let later = at(now + 1);
    assert_eq!(refused(&[at(0), later]), Some(SetpointRefusal::Old));
    assert_eq!(refused(&[]), None);

    let mut circle = Bench::new();
    circle.extra.push(at(TICK_NS));
    let output = circle.step();
    assert_eq!(output.setpoint_refused, Some(SetpointRefusal::NotExternal));
    assert_eq!(output.setpoint, None);
}

#[test]
fn demanded_steering_and_speed_replace_the_law_within_the_limits() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        ..config()
    });
    let limits = config().limits;
    let mut last = None;
    for tick in 0..400 {
        if tick == 100 {
            bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let now = Time((bench.tick + 1) * TICK_NS);
        let (steering, speed) = (SteeringDemand::Angle(1.5), SpeedDemand::Acceleration(50.0));
        let event = Event::Setpoint(Setpoint::actuation(now, steering, speed));
        bench.extra.push(event);
        let output = bench.step();
        assert!(output.point_velocity.is_none() && output.reference.is_none());
        assert_eq!(output.setpoint.map(|stamp| stamp.time), Some(now));
        let actuation = output.actuation;
        if let Some(before) = last.replace(actuation) {
            let rate = (actuation.steering - before.steering) / config().period;
            let change = (actuation.speed - before.speed) / config().period;
            assert!(rate.abs() <= limits.max_steering_rate + 1e-9, "{rate}");
            assert!(change.abs() <= limits.max_acceleration + 1e-9, "{change}");
        }
        assert!(actuation.speed <= limits.max_speed);
    }
    assert_eq!(bench.pilot.mode(), Mode::Driving);
    let last = last.unwrap();
    assert_eq!(last.steering, limits.max_steering);
    assert!((last.speed - limits.speed_in_bend(last.steering)).abs() < 1e-9);
}

#[test]
fn a_demanded_speed_of_the_rear_axle_is_the_command_of_the_board_and_a_steering_rate_its_limit() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        ..config()
    });
    let mut steering = 0.0;
    for tick in 0..600 {
        if tick == 100 {
            bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let (angle, rate) = (0.3, 0.1);
        let steers = SteeringDemand::AngleWithin { angle, rate };
        let speed = SpeedDemand::RearSpeed(0.25);
        let setpoint = Setpoint::actuation(bench.now(), steers, speed);
        bench.extra.push(Event::Setpoint(setpoint));
        let now = bench.step().actuation.steering;
        assert!((now - steering).abs() <= rate * config().period + 1e-9);
        steering = now;
    }
    let output = bench.step();
    assert_eq!(output.mode, Mode::Driving);
    assert!((steering - 0.3).abs() < 1e-9, "{steering}");
    let (command, sideslip) = (output.command.unwrap(), output.estimate.unwrap().sideslip);
    assert!((command.rear_speed - 0.25).abs() < 1e-9, "{command:?}");
    assert!(sideslip > 0.05 && output.actuation.speed > 0.2503);
}

#[test]
fn set_points_that_must_not_be_obeyed_keep_no_car_driving() {
    type Mistake = fn(&mut Setpoint);
    let mistakes: [Mistake; 4] = [
        |setpoint| setpoint.stamp.time.0 += 1,
        |setpoint| setpoint.stamp.time = Time(u64::MAX),
        |setpoint| setpoint.stamp.time.0 -= 201_000_000,
        |setpoint| {
            setpoint.demand = singletrack_control::Demand::Actuation {
                steering: SteeringDemand::Angle(f64::NAN),
                speed: SpeedDemand::Speed(0.5),
            };
        },
    ];
    for mistake in mistakes {
        let mut bench = Bench::with(PilotConfig {
            reference: Reference::External(External::new(0.2).unwrap()),
            ..config()
        });
        let mut modes = Vec::new();
        for tick in 0..300 {
            if tick == 100 {
                bench
                    .extra
                    .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
            }
            let now = Time((bench.tick + 1) * TICK_NS);
            let mut setpoint = Setpoint::point(now, None, Velocity::new(0.5, 0.0));
            if tick >= 200 {
                mistake(&mut setpoint);
            }
            bench.extra.push(Event::Setpoint(setpoint));
            let output = bench.step();
            modes.push((output.mode, output.reason));
        }
        // 200 ms after the last one that may be obeyed.
        assert_eq!(modes[219], (Mode::Driving, None));
        assert_eq!(modes[220], (Mode::Stopping, Some(Reason::SetpointStale)));
    }
}

#[test]
fn a_trajectory_is_followed_by_the_outer_loop_and_ends_the_drive_at_its_end() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        tracking: TrackingLoop::Proportional(ProportionalLoop {
            gain: Velocity::new(2.0, 2.0),
            feed_forward: true,
        }),
        ..config()
    });
    let from = bench.run(100).point.unwrap();
    let begin = bench.now();
    for tick in 0..600 {
        if tick == 20 {
            bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let now = Time((bench.tick + 1) * TICK_NS);
        let trajectory = Trajectory {
            stamp: SetpointStamp {
                time: now,
                sequence: Some(tick),
            },
            points: (0..60)
                .map(|index| {
                    let seconds = 0.1 * f64::from(index);
                    let x = 0.2 * (seconds - 0.3).clamp(0.0, 2.5);
                    TrajectoryPoint {
                        time: begin.after(seconds),
                        position: from + Velocity::new(x, 0.0),
                        velocity: Velocity::new(if x > 0.0 && x < 0.5 { 0.2 } else { 0.0 }, 0.0),
                    }
                })
                .filter(|point| point.time <= begin.after(2.8))
                .collect(),
        };
        bench
            .extra
            .extend(trajectory.pieces().map(Event::TrajectoryPiece));
        let output = bench.step();
        match output.mode {
            Mode::Driving => {
                let reference = output.reference.unwrap();
                let off = output.point.unwrap() - reference.position.unwrap();
                assert!(
                    off.norm() < 0.12 || reference.velocity.x < 0.15,
                    "{tick} {off}"
                );
                assert_eq!(output.setpoint.unwrap().sequence, Some(tick));
            }
            Mode::Stopping => {
                assert_eq!(output.reason, Some(Reason::SetpointStale));
                let moved = output.point.unwrap() - from;
                assert!((moved - Velocity::new(0.5, 0.0)).norm() < 0.1, "{moved}");
                return;
            }
            _ => assert!(tick < 25, "{:?}", output.reason),
        }
    }
    panic!("it drove on after the end");
}

#[test]
fn the_position_loop_approaches_an_external_position() {
    let mut bench = Bench::with(PilotConfig {
        reference: Reference::External(External::new(0.2).unwrap()),
        ..config()
    });
    let target = Position::new(2.0, 0.3);
    for tick in 0..1_500 {
        if tick == 100 {
            bench
                .extra
                .push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
        }
        let event = setpoint(&bench, Velocity::zeros(), Some(target));
        bench.extra.push(event);
        bench.step();
    }
    let point = bench.step().point.unwrap();
    assert!((point - target).norm() < 0.05, "{point}");
}
