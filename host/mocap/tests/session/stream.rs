//! Order of frames, and streams that break.

use singletrack_mocap::{Phase, RestartReason, SessionEvent, planar::PoseState};

use crate::world::{Frame, MS, Outcome, S, Sent, UNICAST, World, config};

fn connected() -> World {
    World::connected(config(UNICAST))
}

#[test]
fn gaps_are_counted_as_lost() {
    let mut world = connected();
    for number in [10, 11, 15, 16] {
        world.next_state(&Frame::at_rest(number));
    }
    assert_eq!(world.session.counters().session.lost, 3);
    assert_eq!(world.session.counters().session.frames, 4);
}

#[test]
fn frame_numbers_may_wrap() {
    let mut world = connected();
    for number in [i32::MAX - 1, i32::MAX, i32::MIN, i32::MIN + 2] {
        world.next_state(&Frame::at_rest(number));
    }
    assert_eq!(world.session.counters().session.lost, 1);
}

#[test]
fn the_same_frame_twice_is_taken_once() {
    let mut world = connected();
    let bytes = world.encode(&Frame::at_rest(1));
    assert!(matches!(world.receive(&bytes), Outcome::Frame(_)));
    assert_eq!(world.receive(&bytes), Outcome::Duplicate);
    assert_eq!(world.session.counters().session.duplicates, 1);
    assert_eq!(world.session.counters().session.frames, 1);
}

#[test]
fn a_frame_that_was_overtaken_is_dropped() {
    let mut world = connected();
    let slow = world.encode(&Frame::at_rest(1));
    world.next_state(&Frame::at_rest(2));
    let state = world.session.pose_state(world.now_ns);
    assert_eq!(world.receive(&slow), Outcome::Late);
    assert_eq!(world.session.counters().session.late, 1);
    assert_eq!(world.session.pose_state(world.now_ns), state);
}

#[test]
fn numbers_that_start_again_while_the_clock_goes_on_are_followed() {
    let mut world = connected();
    world.next_state(&Frame::at_rest(5_000));
    assert!(matches!(
        world.next_state(&Frame::at_rest(0)),
        PoseState::Valid(_)
    ));
    assert_eq!(world.session.counters().session.renumbered, 1);
    assert_eq!(world.session.counters().session.lost, 0);
}

#[test]
fn the_session_connects_again_to_a_server_that_started_again() {
    let mut world = connected();
    for number in 1_000..1_100 {
        world.next_state(&Frame::at_rest(number));
    }
    // Both its numbers and its clock start again.
    world.server.ticks_at_zero = 0;
    for number in 0..100 {
        world.run(10 * MS);
        world.frame(&Frame::at_rest(number));
    }
    assert!(world.events.iter().any(|event| matches!(
        event,
        SessionEvent::Restarted(RestartReason::FramesBackward | RestartReason::ClockBackward)
    )));
    let PoseState::Valid(pose) = world.session.pose_state(world.now_ns) else {
        panic!("{:?}", world.session.pose_state(world.now_ns));
    };
    let truth_ns = world.now_ns - 8 * MS;
    assert!(pose.capture_time_ns.abs_diff(truth_ns) <= pose.capture_uncertainty_ns);
}

#[test]
fn a_few_old_frames_do_not_restart_the_session() {
    let mut world = connected();
    let old: Vec<_> = (1..10)
        .map(|number| {
            world.run(MS);
            world.encode(&Frame::at_rest(number))
        })
        .collect();
    world.next_state(&Frame::at_rest(20));
    for bytes in &old {
        assert_eq!(world.receive(bytes), Outcome::Late);
    }
    world.next_state(&Frame::at_rest(21));
    assert_eq!(world.session.counters().session.restarts, 0);
    assert_eq!(world.session.counters().session.late, 9);
}

#[test]
fn a_malformed_datagram_is_counted_and_changes_nothing() {
    let mut world = connected();
    world.next_state(&Frame::at_rest(1));
    let before = world.session.pose_state(world.now_ns);
    let good = world.encode(&Frame::at_rest(2));
    for len in 0..good.len() {
        assert!(matches!(world.receive(&good[..len]), Outcome::Malformed));
    }
    assert_eq!(
        world.session.counters().session.malformed,
        good.len() as u64
    );
    assert_eq!(world.session.counters().session.frames, 1);
    assert_eq!(world.session.pose_state(world.now_ns), before);
    assert!(matches!(world.session.phase(), Phase::Streaming(_)));
}

#[test]
fn a_bitstream_that_changes_in_the_stream_is_negotiated_again() {
    let mut world = connected();
    world.next_state(&Frame::at_rest(1));
    world.server.native = [3, 1];
    world.server.stream = singletrack_mocap::codec::BitstreamVersion::V3_1;
    for number in 2..40 {
        world.run(10 * MS);
        world.frame(&Frame::at_rest(number));
    }
    assert!(matches!(
        world.session.pose_state(world.now_ns),
        PoseState::Valid(_)
    ));
    assert_eq!(world.session.counters().session.malformed, 20);
}

/// A frame of another bitstream than the session's.
fn undecodable(world: &mut World) -> Vec<u8> {
    let native = world.server.stream;
    world.server.stream = singletrack_mocap::codec::BitstreamVersion::V3_1;
    let bytes = world.encode(&Frame::at_rest(1_000));
    world.server.stream = native;
    bytes
}

#[test]
fn undecodable_frames_between_good_ones_do_not_restart_the_session() {
    let mut world = connected();
    let undecodable = undecodable(&mut world);
    for number in 1..50 {
        world.next_state(&Frame::at_rest(number));
        for _ in 0..100 {
            assert!(matches!(world.receive(&undecodable), Outcome::Malformed));
        }
    }
    assert_eq!(world.session.counters().session.restarts, 0);
    assert!(matches!(world.session.phase(), Phase::Streaming(_)));
}

#[test]
fn a_flood_of_undecodable_frames_restarts_the_session_ten_times_a_second_at_most() {
    let mut world = connected();
    let undecodable = undecodable(&mut world);
    for _ in 0..1_000 {
        world.run(MS);
        for _ in 0..100 {
            world.receive(&undecodable);
        }
    }
    let restarts = world.session.counters().session.restarts;
    assert!((1..=10).contains(&restarts), "{restarts}");
}

#[test]
fn the_session_connects_again_when_the_stream_is_silent() {
    let mut world = connected();
    world.next_state(&Frame::at_rest(1));
    world.sent.clear();
    world.run(1_990 * MS);
    assert_eq!(world.count_sent(&Sent::Connect), 0);
    assert!(world.events.contains(&SessionEvent::Stale));
    world.run(20 * MS);
    assert_eq!(world.count_sent(&Sent::Connect), 1);
    assert!(
        world
            .events
            .contains(&SessionEvent::Restarted(RestartReason::Silence))
    );
    assert!(matches!(
        world.next_state(&Frame::at_rest(500)),
        PoseState::Valid(_)
    ));
}

#[test]
fn the_session_connects_again_when_a_server_sends_no_frames() {
    let mut world = connected();
    world.sent.clear();
    world.run(10 * S);
    assert!((4..=5).contains(&world.count_sent(&Sent::Connect)));
}
