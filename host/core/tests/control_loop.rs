//! The control loop with the simulated car, in virtual time: requests, configurations,
//! set-points and stalls.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use singletrack_control::{Setpoint, Time, Velocity};
use singletrack_core::{
    Config, ControlRequest, Proofs, Refusal,
    config::{OuterLoopSection, ReferenceSection},
    configuration_hash,
    controller::Controller,
    line::Sent,
};
use singletrack_link::Session as LinkSession;
use singletrack_mocap::{Observation, PoseState};
use singletrack_pilot::{Arming, Event, Mode, Pilot, PilotRequest, RealTimeState, Reason};
use singletrack_protocol::{BoardMode, Decoder, ToBoard};

use crate::simulated_drive::{PERIOD_US, SimulatedDrive};

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
    let mut drive = SimulatedDrive::new();
    let start = drive.start_driving();
    let mut queued = Vec::new();
    for index in start..start + 50 {
        drive.stuck = true;
        drive.run_until_tick(index);
        drive.tick(index);
        queued.extend(drive.sent());
        while drive.host.reports.pop().is_ok() {}
        while drive.host.ticks.pop().is_some() {}
    }
    assert!(
        (1..=2).contains(&drives(&queued)),
        "{} commands",
        drives(&queued)
    );
    assert!(drive.host.control.counters().drives_withheld > 0);
}

#[test]
fn a_finish_stops_the_car_and_disarms_the_board_first() {
    let mut drive = SimulatedDrive::new();
    let start = drive.start_driving();
    drive.request(ControlRequest::Finish);
    let mut ticks = 0;
    let mut modes = Vec::new();
    while !drive.host.control.is_done() {
        modes.extend(drive.step(start + ticks));
        ticks += 1;
        assert!(ticks < 200, "never done");
    }
    modes.dedup();
    assert!(
        modes.starts_with(&[Mode::Stopping, Mode::Idle]),
        "{modes:?}"
    );
    // At neutral it coasts the rest of the way.
    let speed = drive.world.truth().speed;
    assert!(speed.abs() < 0.1, "{speed} m/s");
    assert_eq!(drive.board_mode(), Some(BoardMode::Neutral));
}

#[test]
fn an_abort_disarms_the_board_at_full_speed() {
    let mut drive = SimulatedDrive::new();
    let start = drive.start_driving();
    drive.request(ControlRequest::Abort);
    let mut ticks = 0;
    while !drive.host.control.is_done() {
        drive.step(start + ticks);
        ticks += 1;
        assert!(ticks < 10, "not at once");
    }
    assert_eq!(drive.board_mode(), Some(BoardMode::Neutral));
}

#[test]
fn a_finish_of_a_car_at_rest_is_done_at_the_next_tick() {
    let mut drive = SimulatedDrive::new();
    for index in 1..100 {
        drive.step(index);
    }
    drive.request(ControlRequest::Finish);
    drive.tick(100);
    assert!(drive.host.control.is_done());
}

#[test]
fn a_disarm_before_ready_cancels_arming_at_the_start() {
    let mut drive = SimulatedDrive::new();
    drive.request(ControlRequest::Pilot(PilotRequest::Disarm));
    let mut modes = Vec::new();
    for index in 1..600 {
        modes.extend(drive.step(index));
    }
    modes.dedup();
    assert_eq!(modes, [Mode::Disconnected, Mode::Idle, Mode::Ready]);

    // An end in the same tick as an arm request leaves nothing armed.
    drive.request(ControlRequest::Pilot(PilotRequest::Arm(Arming::Unattended)));
    drive.request(ControlRequest::Finish);
    for index in 600..640 {
        drive.step(index);
        assert_eq!(drive.board_mode(), Some(BoardMode::Neutral));
    }
    assert!(drive.host.control.is_done());
}

fn controller() -> Controller {
    let config = Config::from_toml(include_str!("../../daemon/singletrackd.example.toml")).unwrap();
    Controller::new(
        LinkSession::new(config.link(7)).unwrap(),
        config.steering_map().unwrap(),
        Pilot::new(config.pilot().unwrap()),
        configuration_hash(&config).unwrap(),
        Proofs::default(),
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
    controller.push(Event::Request(PilotRequest::EmergencyStop));
    let tick = controller.tick(Time(1), &mut |_| Sent::Whole, &mut |_| {});
    assert!(tick.dropped_events > 0);
    assert!(
        tick.events
            .contains(&Event::Request(PilotRequest::EmergencyStop))
    );
    assert_eq!(tick.output.mode, Mode::Fault);
}

#[test]
fn after_a_long_pause_a_stop_finds_room_among_other_events() {
    let mut controller = controller();
    observe(&mut controller, 1_000);
    for _ in 0..100 {
        controller.push(Event::RealTime(RealTimeState {
            fifo: true,
            memory_locked: true,
        }));
        controller.port_closed(Time(1), &mut |_| {});
    }
    for _ in 0..12 {
        controller.push(Event::Request(PilotRequest::Arm(Arming::Unattended)));
    }
    controller.push(Event::Request(PilotRequest::EmergencyStop));
    let tick = controller.tick(Time(1), &mut |_| Sent::Whole, &mut |_| {});
    assert!(
        tick.events
            .contains(&Event::Request(PilotRequest::EmergencyStop))
    );
    assert_eq!(tick.output.mode, Mode::Fault);
}

#[test]
fn of_many_set_points_in_a_tick_the_pilot_gets_the_newest() {
    let mut controller = controller();
    for ms in 0..1_000 {
        controller.push(Event::Setpoint(Setpoint::point(
            Time(ms),
            None,
            Velocity::zeros(),
        )));
    }
    let tick = controller.tick(Time(1_000), &mut |_| Sent::Whole, &mut |_| {});
    let seen: Vec<_> = tick
        .events
        .iter()
        .filter_map(|event| match event {
            Event::Setpoint(setpoint) => Some(setpoint.stamp.time.0),
            _ => None,
        })
        .collect();
    assert_eq!((seen, tick.dropped_events), (vec![999], 0));
}

/// Runs `ticks` ticks from `index` on; the modes that they ended in, each once.
fn run(drive: &mut SimulatedDrive, index: u64, ticks: u64) -> Vec<Mode> {
    let mut modes = Vec::new();
    for index in index..index + ticks {
        modes.extend(drive.step(index));
    }
    modes.dedup();
    modes
}

#[test]
fn a_configuration_is_taken_over_between_two_ticks_and_its_box_is_returned() {
    let mut drive = SimulatedDrive::new();
    drive.request(ControlRequest::Pilot(PilotRequest::Disarm));
    run(&mut drive, 1, 300);
    let mut config = drive.config();
    config.limits.max_speed_m_s = 0.2;
    config.board.speed.max_forward_mm_s = 300;
    drive.reconfigure(config, u64::MAX);
    drive.run_until_tick(301);
    drive.tick(301);
    assert_eq!(drive.outcome(), Ok(()));
    let record = drive.host.ticks.pop().unwrap();
    assert!(record.events.contains(&Event::Reconfigured(2)));

    // Pilot and board are as before, only slower.
    run(&mut drive, 302, 200);
    drive.request(ControlRequest::Pilot(PilotRequest::Arm(Arming::Unattended)));
    run(&mut drive, 502, 300);
    assert_eq!(drive.board_mode(), Some(BoardMode::Driving));
    let speed = drive.world.truth().speed;
    assert!((0.15..0.22).contains(&speed), "{speed} m/s");
}

#[test]
fn a_configuration_does_not_overtake_a_request_to_arm_of_the_same_tick() {
    for request in [
        PilotRequest::Arm(Arming::Unattended),
        PilotRequest::Arm(Arming::Held),
        PilotRequest::Arm(Arming::Jog),
    ] {
        let mut drive = SimulatedDrive::new();
        drive.request(ControlRequest::Pilot(PilotRequest::Disarm));
        run(&mut drive, 1, 300);
        drive.request(ControlRequest::Pilot(request));
        let config = drive.config();
        drive.reconfigure(config, u64::MAX);
        run(&mut drive, 301, 1);
        let outcome = drive.outcome();
        assert!(
            matches!(outcome, Err(Refusal::Underway(_))),
            "{request:?}: {outcome:?}"
        );
    }
}

#[test]
fn the_reference_begins_at_the_time_that_was_asked_for_whichever_tick_comes_next() {
    // Of the ticks at 3.49, 3.50 and 3.51 s.
    for (at_ns, begins) in [(3_490_000_000, 349), (3_494_000_000, 350)] {
        let mut drive = SimulatedDrive::new();
        drive.request(ControlRequest::Pilot(PilotRequest::Disarm));
        run(&mut drive, 1, 300);
        drive.request(ControlRequest::ArmAt(at_ns));
        let mut index = 300;
        let drive_time = loop {
            index += 1;
            drive.request(ControlRequest::Pilot(PilotRequest::Hold));
            drive.run_until_tick(index);
            drive.tick(index);
            let output = drive.output().unwrap();
            // As ticks of any drive: at most 20 us.
            let slide_ns = drive.host.control.slide_ns;
            assert!(!output.mode.is_underway() || slide_ns.abs() <= 20_000);
            if let Some(drive_time) = output.drive_time {
                break drive_time;
            }
            assert!(index < begins, "{:?}: {:?}", output.mode, output.reason);
            assert_eq!(drive.world.truth().speed, 0.0);
        };
        assert_eq!(index, begins);
        let since_s = (10_000_000 * index - at_ns) as f64 * 1e-9;
        assert!((drive_time - since_s).abs() < 1e-9, "{drive_time}");
    }
}

#[test]
fn a_car_that_drives_keeps_its_configuration() {
    let mut drive = SimulatedDrive::new();
    let start = drive.start_driving();
    let config = drive.config();
    drive.reconfigure(config, u64::MAX);
    let modes = run(&mut drive, start, 50);
    let outcome = drive.outcome();
    assert!(matches!(outcome, Err(Refusal::Underway(_))), "{outcome:?}");
    assert_eq!(modes, [Mode::Driving]);
}

#[test]
fn a_configuration_is_not_taken_over_after_its_deadline_or_at_the_end() {
    let mut drive = SimulatedDrive::new();
    let config = drive.config();
    drive.reconfigure(config.clone(), 10 * PERIOD_US * 1_000);
    drive.tick(11);
    assert_eq!(drive.outcome(), Err(Refusal::Late));

    drive.request(ControlRequest::Finish);
    drive.reconfigure(config, u64::MAX);
    drive.tick(12);
    assert_eq!(drive.outcome(), Err(Refusal::Ending));
}

fn setpoint(time_us: u64, velocity: Velocity) -> Setpoint {
    Setpoint::point(Time(time_us * 1_000), None, velocity)
}

#[test]
fn of_many_set_points_a_tick_sees_the_newest() {
    let mut drive = SimulatedDrive::new();
    for number in 1..=1_000 {
        let velocity = Velocity::new(number as f64, 0.0);
        drive.host.setpoints.send(&setpoint(number, velocity));
    }
    let setpoints = |drive: &mut SimulatedDrive| -> Vec<Setpoint> {
        let record = drive.host.ticks.pop().unwrap();
        let setpoint = |event: &Event| match event {
            Event::Setpoint(setpoint) => Some(*setpoint),
            _ => None,
        };
        record.events.iter().filter_map(setpoint).collect()
    };
    drive.tick(1);
    let seen = setpoints(&mut drive);
    assert_eq!(seen, [setpoint(1_000, Velocity::new(1_000.0, 0.0))]);
    drive.tick(2);
    assert_eq!(setpoints(&mut drive), []);
}

#[test]
fn the_car_follows_set_points_and_stops_when_they_cease() {
    let mut drive = SimulatedDrive::new();
    let mut config = drive.config();
    config.reference = ReferenceSection::External {
        setpoint_timeout_ms: 200,
    };
    config.outer_loop = OuterLoopSection::OpenLoop {};
    drive.reconfigure(config, u64::MAX);
    let mut index = 1;
    let mut driving = 0;
    let heading = drive.world.truth().yaw;
    let ahead = Velocity::new(0.3 * heading.cos(), 0.3 * heading.sin());
    while driving < 200 {
        drive
            .host
            .setpoints
            .send(&setpoint(index * PERIOD_US, ahead));
        let modes = run(&mut drive, index, 1);
        driving += u64::from(modes == [Mode::Driving]);
        index += 1;
        assert!(index < 2_000, "it never drove: {modes:?}");
    }
    assert_eq!(drive.outcome(), Ok(()));
    let speed = drive.world.truth().speed;
    assert!((0.25..0.35).contains(&speed), "{speed} m/s");

    let last = index;
    let (stopping, reason) = loop {
        drive.run_until_tick(index);
        drive.tick(index);
        let record = drive.host.ticks.pop().unwrap();
        if record.output.mode != Mode::Driving {
            break (index, record.output.reason);
        }
        let sent = drive.sent();
        drive.world.host_write(&sent);
        index += 1;
    };
    assert_eq!(reason, Some(Reason::SetpointStale));
    // 200 ms after the last one, and a tick.
    assert!(
        (20..=21).contains(&(stopping - last)),
        "{}",
        stopping - last
    );
    drive.after_tick();
    run(&mut drive, stopping + 1, 200);
    assert!(drive.world.truth().speed.abs() < 0.05);
    assert_eq!(drive.board_mode(), Some(BoardMode::Neutral));
}

#[test]
fn after_a_stall_the_newest_pose_is_among_what_a_tick_takes_in() {
    let mut drive = SimulatedDrive::new();
    let start = drive.start_driving();
    // The thread sleeps for half a second; the rest of the world goes on.
    let stall = 50;
    for index in start..start + stall {
        drive.run_until_tick(index);
    }
    let newest = drive.last_frame;
    drive.tick(start + stall - 1);
    let record = drive.host.ticks.pop().unwrap();
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
