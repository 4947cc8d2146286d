//! The body of the control thread in virtual time, with the simulated car at
//! the other end of its rings: what it does when it is asked to, and that it
//! queues nothing.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

#[path = "common/outside.rs"]
mod outside;

use outside::{Outside, PERIOD_US, RingLine, drive, set_up, tick};
use singletrack_control::{Position, Setpoint, Time, Velocity};
use singletrack_core::{
    Config, ControlRequest, Refusal,
    config::{OuterLoopSection, ReferenceSection},
    control_loop::ControlLoop,
    controller::{Controller, ReconfigureError},
    line::Sent,
};
use singletrack_link::Session as LinkSession;
use singletrack_mocap::{Observation, PoseState};
use singletrack_pilot::PilotRequest;
use singletrack_pilot::{Event, Mode, Pilot, RealTimeState, Reason};
use singletrack_protocol::{BoardMode, Decoder, ToBoard};

/// The drive commands in `bytes`.
fn drives(bytes: &[u8]) -> usize {
    let mut decoder = Decoder::new();
    bytes
        .iter()
        .filter(|&&byte| {
            decoder.push(byte).is_some_and(|packet| {
                matches!(ToBoard::decode(packet.unwrap()), Ok(ToBoard::Drive(_)))
            })
        })
        .count()
}

#[test]
fn a_line_that_is_stuck_both_ways_holds_two_commands_at_most() {
    let (mut control, mut outside) = set_up();
    let start = drive(&mut control, &mut outside);
    let mut queued = Vec::new();
    for index in start..start + 50 {
        outside.stuck = true;
        outside.run_until_tick(index);
        tick(&mut control, index);
        queued.extend(outside.sent());
        while outside.reports.pop().is_ok() {}
        while outside.ticks.pop().is_some() {}
    }
    assert!(
        (1..=2).contains(&drives(&queued)),
        "{} commands",
        drives(&queued)
    );
    assert!(control.counters().drives_withheld > 0);
}

#[test]
fn asked_to_finish_it_stops_the_car_and_disarms_the_board_first() {
    let (mut control, mut outside) = set_up();
    let start = drive(&mut control, &mut outside);
    outside.requests.push(ControlRequest::Finish).unwrap();
    let mut ticks = 0;
    let mut modes = Vec::new();
    while !control.is_done() {
        let index = start + ticks;
        outside.run_until_tick(index);
        tick(&mut control, index);
        modes.extend(outside.after_tick());
        ticks += 1;
        assert!(ticks < 200, "never done");
    }
    modes.dedup();
    assert!(
        modes.starts_with(&[Mode::Stopping, Mode::Idle]),
        "{modes:?}"
    );
    // At neutral it coasts the rest of the way.
    let speed = outside.world.truth().speed;
    assert!(speed.abs() < 0.1, "{speed} m/s");
    assert_eq!(outside.board_mode(), Some(BoardMode::Neutral));
}

#[test]
fn asked_to_abort_it_disarms_the_board_at_full_speed() {
    let (mut control, mut outside) = set_up();
    let start = drive(&mut control, &mut outside);
    outside.requests.push(ControlRequest::Abort).unwrap();
    let mut ticks = 0;
    while !control.is_done() {
        let index = start + ticks;
        outside.run_until_tick(index);
        tick(&mut control, index);
        outside.after_tick();
        ticks += 1;
        assert!(ticks < 10, "not at once");
    }
    assert_eq!(outside.board_mode(), Some(BoardMode::Neutral));
}

#[test]
fn standing_it_is_done_at_the_next_tick() {
    let (mut control, mut outside) = set_up();
    for index in 1..100 {
        outside.run_until_tick(index);
        tick(&mut control, index);
        outside.after_tick();
    }
    outside.requests.push(ControlRequest::Finish).unwrap();
    tick(&mut control, 100);
    assert!(control.is_done());
}

#[test]
fn whoever_says_stop_before_it_was_ready_takes_back_that_it_arms_by_itself() {
    let (mut control, mut outside) = set_up();
    outside
        .requests
        .push(ControlRequest::Pilot(PilotRequest::Disarm))
        .unwrap();
    let mut modes = Vec::new();
    for index in 1..600 {
        outside.run_until_tick(index);
        tick(&mut control, index);
        modes.extend(outside.after_tick());
    }
    modes.dedup();
    assert_eq!(modes, [Mode::Disconnected, Mode::Idle, Mode::Ready]);

    // And to end in the tick in which somebody arms leaves nothing armed.
    outside
        .requests
        .push(ControlRequest::Pilot(PilotRequest::Arm))
        .unwrap();
    outside.requests.push(ControlRequest::Finish).unwrap();
    for index in 600..640 {
        outside.run_until_tick(index);
        tick(&mut control, index);
        outside.after_tick();
        assert_eq!(outside.board_mode(), Some(BoardMode::Neutral));
    }
    assert!(control.is_done());
}

fn controller() -> Controller {
    let config = Config::from_toml(include_str!("../../daemon/singletrackd.example.toml")).unwrap();
    Controller::new(
        LinkSession::new(config.link(7)).unwrap(),
        Pilot::new(config.pilot().unwrap()),
    )
}

fn observe(controller: &mut Controller, times: i32) {
    for frame_number in 0..times {
        controller.observed(&Observation {
            frame_number,
            receive_time_ns: 1,
            state: PoseState::Absent,
        });
    }
}

#[test]
fn a_flood_of_samples_leaves_room_for_a_stop() {
    let mut controller = controller();
    observe(&mut controller, 1_000);
    controller.request(PilotRequest::EmergencyStop);
    let tick = controller.tick(Time(1), &mut |_| Sent::Whole, &mut |_| {});
    assert!(tick.dropped_events > 0);
    assert!(
        tick.events
            .contains(&Event::Request(PilotRequest::EmergencyStop))
    );
    assert_eq!(tick.output.mode, Mode::Fault);
}

#[test]
fn after_a_long_pause_a_stop_is_heard_whatever_else_has_piled_up() {
    let mut controller = controller();
    observe(&mut controller, 1_000);
    for _ in 0..100 {
        controller.real_time(RealTimeState {
            fifo: true,
            memory_locked: true,
        });
        controller.port_closed(Time(1), &mut |_| {});
    }
    for _ in 0..12 {
        controller.request(PilotRequest::Arm);
    }
    controller.request(PilotRequest::EmergencyStop);
    let tick = controller.tick(Time(1), &mut |_| Sent::Whole, &mut |_| {});
    assert!(
        tick.events
            .contains(&Event::Request(PilotRequest::EmergencyStop))
    );
    assert_eq!(tick.output.mode, Mode::Fault);
}

#[test]
fn of_many_set_points_in_a_tick_only_the_newest_is_told() {
    let mut controller = controller();
    for ms in 0..1_000 {
        controller.setpoint(Setpoint {
            time: Time(ms),
            position: None,
            velocity: Velocity::zeros(),
        });
    }
    let tick = controller.tick(Time(1_000), &mut |_| Sent::Whole, &mut |_| {});
    let told: Vec<_> = tick
        .events
        .iter()
        .filter_map(|event| match event {
            Event::Setpoint(setpoint) => Some(setpoint.time.0),
            _ => None,
        })
        .collect();
    assert_eq!((told, tick.dropped_events), (vec![999], 0));
}

/// Runs `ticks` ticks from `index` on; the modes that they ended in, each once.
fn run(
    control: &mut ControlLoop<RingLine>,
    outside: &mut Outside,
    index: u64,
    ticks: u64,
) -> Vec<Mode> {
    let mut modes = Vec::new();
    for index in index..index + ticks {
        outside.run_until_tick(index);
        tick(control, index);
        modes.extend(outside.after_tick());
    }
    modes.dedup();
    modes
}

#[test]
fn a_configuration_is_taken_over_between_two_ticks_and_its_box_comes_back() {
    let (mut control, mut outside) = set_up();
    outside
        .requests
        .push(ControlRequest::Pilot(PilotRequest::Disarm))
        .unwrap();
    run(&mut control, &mut outside, 1, 300);
    let mut config = outside.config.clone();
    config.limits.max_speed_m_s = 0.2;
    config.board.speed.max_forward_mm_s = 300;
    outside.reconfigure(&config, u64::MAX);
    outside.run_until_tick(301);
    tick(&mut control, 301);
    assert_eq!(outside.outcome(), Ok(()));
    let record = outside.ticks.pop().unwrap();
    assert!(record.events.contains(&Event::Reconfigured(2)));

    // Pilot and board are as before, only slower.
    run(&mut control, &mut outside, 302, 200);
    outside
        .requests
        .push(ControlRequest::Pilot(PilotRequest::Arm))
        .unwrap();
    run(&mut control, &mut outside, 502, 300);
    assert_eq!(outside.board_mode(), Some(BoardMode::Driving));
    let speed = outside.world.truth().speed;
    assert!((0.15..0.22).contains(&speed), "{speed} m/s");
}

#[test]
fn a_car_that_drives_keeps_its_configuration() {
    let (mut control, mut outside) = set_up();
    let start = drive(&mut control, &mut outside);
    let config = outside.config.clone();
    outside.reconfigure(&config, u64::MAX);
    let modes = run(&mut control, &mut outside, start, 50);
    let outcome = outside.outcome();
    assert!(
        matches!(outcome, Err(Refusal::Pilot(ReconfigureError::Underway(_)))),
        "{outcome:?}"
    );
    assert_eq!(modes, [Mode::Driving]);
}

#[test]
fn a_configuration_for_which_nobody_waits_any_more_is_not_taken_over() {
    let (mut control, mut outside) = set_up();
    let config = outside.config.clone();
    outside.reconfigure(&config, 10 * PERIOD_US * 1_000);
    tick(&mut control, 11);
    assert_eq!(outside.outcome(), Err(Refusal::Late));

    outside.requests.push(ControlRequest::Finish).unwrap();
    outside.reconfigure(&config, u64::MAX);
    tick(&mut control, 12);
    assert_eq!(outside.outcome(), Err(Refusal::Ending));
}

fn setpoint(time_us: u64, velocity: Velocity) -> Setpoint {
    Setpoint {
        time: Time(time_us * 1_000),
        position: None,
        velocity,
    }
}

#[test]
fn of_many_set_points_a_tick_sees_the_newest() {
    let (mut control, mut outside) = set_up();
    for number in 1..=1_000 {
        outside.setpoints.send(&Setpoint {
            position: Some(Position::new(number as f64, 0.0)),
            ..setpoint(number, Velocity::zeros())
        });
    }
    let setpoints = |outside: &mut Outside| -> Vec<Setpoint> {
        let record = outside.ticks.pop().unwrap();
        let setpoint = |event: &Event| match event {
            Event::Setpoint(setpoint) => Some(*setpoint),
            _ => None,
        };
        record.events.iter().filter_map(setpoint).collect()
    };
    tick(&mut control, 1);
    let seen = setpoints(&mut outside);
    assert_eq!(seen.len(), 1);
    assert_eq!(seen[0].position, Some(Position::new(1_000.0, 0.0)));
    tick(&mut control, 2);
    assert_eq!(setpoints(&mut outside), []);
}

#[test]
fn the_car_follows_set_points_and_stops_when_they_cease() {
    let (mut control, mut outside) = set_up();
    let mut config = outside.config.clone();
    config.reference = ReferenceSection::External {
        setpoint_timeout_ms: 200,
    };
    config.outer_loop = OuterLoopSection::OpenLoop {};
    outside.reconfigure(&config, u64::MAX);
    let mut index = 1;
    let mut driving = 0;
    let heading = outside.world.truth().yaw;
    let ahead = Velocity::new(0.3 * heading.cos(), 0.3 * heading.sin());
    while driving < 200 {
        outside.setpoints.send(&setpoint(index * PERIOD_US, ahead));
        let modes = run(&mut control, &mut outside, index, 1);
        driving += u64::from(modes == [Mode::Driving]);
        index += 1;
        assert!(index < 2_000, "it never drove: {modes:?}");
    }
    assert_eq!(outside.outcome(), Ok(()));
    let speed = outside.world.truth().speed;
    assert!((0.25..0.35).contains(&speed), "{speed} m/s");

    let last = index;
    let (stopping, reason) = loop {
        outside.run_until_tick(index);
        tick(&mut control, index);
        let record = outside.ticks.pop().unwrap();
        if record.output.mode != Mode::Driving {
            break (index, record.output.reason);
        }
        let sent = outside.sent();
        outside.world.host_write(&sent);
        index += 1;
    };
    assert_eq!(reason, Some(Reason::SetpointStale));
    // 200 ms after the last one, and a tick.
    assert!(
        (20..=21).contains(&(stopping - last)),
        "{}",
        stopping - last
    );
    outside.after_tick();
    run(&mut control, &mut outside, stopping + 1, 200);
    assert!(outside.world.truth().speed.abs() < 0.05);
    assert_eq!(outside.board_mode(), Some(BoardMode::Neutral));
}

#[test]
fn after_a_stall_the_newest_pose_is_among_what_a_tick_takes_in() {
    let (mut control, mut outside) = set_up();
    let start = drive(&mut control, &mut outside);
    // The thread sleeps for half a second; the rest of the world goes on.
    let stall = 50;
    for index in start..start + stall {
        outside.run_until_tick(index);
    }
    let newest = outside.last_frame;
    tick(&mut control, start + stall - 1);
    let record = outside.ticks.pop().unwrap();
    let frames: Vec<i32> = record
        .events
        .iter()
        .filter_map(|event| match event {
            Event::Pose(pose) => Some(pose.frame),
            _ => None,
        })
        .collect();
    assert_eq!(frames.last(), Some(&newest));
    assert!(frames.is_sorted() && frames.len() <= 16, "{frames:?}");
    assert!(record.events_dropped > 0);
}
