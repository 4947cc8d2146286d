//! Order of frames, streams that break, two senders with the server's address, and deadlines.

use std::net::SocketAddr;

use proptest::prelude::*;
use singletrack_mocap::{
    Phase, RejectReason, RestartReason, SessionEvent, Transport, planar::PoseState,
};

use crate::{
    Frame, MS, Outcome, S, SERVER, Sent, TICKS_PER_SECOND, UNICAST, World, car_at, config, jitter,
};

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
    assert!(matches!(
        world.session.source().phase(),
        Phase::Streaming(_)
    ));
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
    assert!(matches!(
        world.session.source().phase(),
        Phase::Streaming(_)
    ));
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

/// A world that has streamed for a second, up to frame 100.
fn streaming() -> World {
    let mut world = World::connected(config(UNICAST));
    for number in 1..=100 {
        world.next_state(&Frame::at_rest(number));
    }
    assert_eq!(world.session.counters().session.contradictions, 0);
    world
}

fn contradicted(world: &World) -> usize {
    let events = world.events.iter();
    events
        .filter(|event| **event == SessionEvent::Contradicted)
        .count()
}

/// Another car at the place, with the same number.
fn forged(number: i32) -> Frame {
    Frame::new(number, &[car_at(0.01, 0.0)])
}

#[test]
fn other_content_for_the_same_number_is_counted_and_soon_no_pose_is_accepted() {
    let mut world = streaming();
    let mut accepted = 0;
    for number in 101..=150 {
        world.run(10 * MS);
        // The forged frame is first, and is taken for the server's.
        if let Outcome::Frame(observation) = world.frame(&forged(number)) {
            accepted += u32::from(matches!(observation.state, PoseState::Valid(_)));
        }
        assert_eq!(world.frame(&Frame::at_rest(number)), Outcome::Late);
    }
    assert_eq!(accepted, 3);
    let counters = world.session.counters().session;
    assert_eq!((counters.contradictions, counters.distrusted), (50, 47));
    assert_eq!(contradicted(&world), 1);
    assert!(world.session.source().is_contradicted(world.now_ns));
    assert!(matches!(
        world.session.pose_state(world.now_ns),
        PoseState::LockedOut(RejectReason::CaptureTime)
    ));
    // A second without contradictions restores the trust.
    for number in 151..=300 {
        world.next_state(&Frame::at_rest(number));
    }
    assert!(!world.session.source().is_contradicted(world.now_ns));
    assert!(matches!(
        world.session.pose_state(world.now_ns),
        PoseState::Valid(_)
    ));
}

#[test]
fn a_frame_from_a_second_port_is_dropped_while_the_first_is_alive() {
    let mut world = streaming();
    let other = SocketAddr::new(SERVER.ip(), 40_000);
    let from = |world: &mut World, frame: &Frame| {
        let bytes = world.encode(frame);
        world.receive_from(other, &bytes)
    };
    world.run(10 * MS);
    assert_eq!(from(&mut world, &forged(101)), Outcome::Late);
    assert_eq!(world.session.counters().session.contradictions, 1);
    assert!(matches!(
        world.frame(&Frame::at_rest(101)),
        Outcome::Frame(_)
    ));
    // A server that starts again may use another port.
    world.run(S);
    assert!(matches!(
        from(&mut world, &Frame::at_rest(201)),
        Outcome::Frame(_)
    ));
}

#[test]
fn a_number_far_ahead_does_not_make_the_servers_frames_late() {
    let mut world = streaming();
    world.run(5 * MS);
    assert_eq!(world.frame(&forged(5_000)), Outcome::Late);
    assert!(matches!(
        world.next_state(&Frame::at_rest(101)),
        PoseState::Valid(_)
    ));
    let counters = world.session.counters().session;
    assert_eq!((counters.contradictions, counters.lost), (1, 0));
}

#[test]
fn a_clock_far_ahead_does_not_make_the_servers_frames_late() {
    let mut world = streaming();
    world.run(5 * MS);
    world.server.ticks_at_zero += 10 * TICKS_PER_SECOND;
    let bytes = world.encode(&forged(101));
    world.server.ticks_at_zero -= 10 * TICKS_PER_SECOND;
    assert_eq!(world.receive(&bytes), Outcome::Late);
    assert!(matches!(
        world.next_state(&Frame::at_rest(102)),
        PoseState::Valid(_)
    ));
}

#[test]
fn a_server_whose_numbers_really_jump_is_followed_after_a_few_frames() {
    let mut world = streaming();
    for number in 5_000..5_100 {
        world.run(10 * MS);
        world.frame(&Frame::at_rest(number));
    }
    world.run(S);
    for number in 5_100..5_200 {
        world.run(10 * MS);
        world.frame(&Frame::at_rest(number));
    }
    assert_eq!(world.session.counters().session.restarts, 1);
    assert!(matches!(
        world.session.pose_state(world.now_ns),
        PoseState::Valid(_)
    ));
}

#[test]
fn frames_that_were_lost_late_or_doubled_by_the_network_contradict_nothing() {
    let mut world = streaming();
    // A stall of the receiver, a queue, a burst, a gap and a doubled datagram.
    let queue: Vec<_> = (101..300)
        .map(|number| {
            world.run(10 * MS);
            world.encode(&Frame::at_rest(number))
        })
        .collect();
    for bytes in &queue {
        world.receive(bytes);
        world.receive(bytes);
    }
    world.run(3 * S);
    for number in [600, 601, 650, 651] {
        world.run(10 * MS * if number == 650 { 49 } else { 1 });
        world.frame(&Frame::at_rest(number));
    }
    assert_eq!(world.session.counters().session.contradictions, 0);
}

/// Asserts that the session does nothing by itself from now to its deadline.
#[track_caller]
fn assert_idle_until_deadline(world: &World, part_way: f64) {
    let deadline_ns = world.session.poll_timeout();
    let last_ns = deadline_ns.map_or(u64::MAX, |deadline_ns| deadline_ns - 1);
    let wait_ns = last_ns.checked_sub(world.now_ns).unwrap();
    for at_ns in [
        world.now_ns,
        world.now_ns + (wait_ns as f64 * part_way) as u64,
        last_ns,
    ] {
        let mut session = world.session.clone();
        session.handle_timeout(at_ns, &mut |event| {
            panic!("{event:?} at {at_ns}, due at {deadline_ns:?}");
        });
        assert_eq!(session.poll_transmit(at_ns), None, "due at {deadline_ns:?}");
        assert_eq!(format!("{session:?}"), format!("{:?}", world.session));
    }
}

proptest! {
    #[test]
    fn before_its_deadline_a_session_does_nothing(
        options in any::<[bool; 4]>(),
        native in prop::sample::select(vec![[2, 5], [2, 9], [3, 0], [4, 1], [4, 3], [4, 5]]),
        bitstream_status in prop::sample::select(vec![Some(0), Some(1), None]),
        loses_one_in in prop::sample::select(vec![1_u64, 2, 1_000]),
        seed: u64,
        steps in prop::collection::vec((0..8_u8, 0..400_u64, 0.0..1.0_f64), 1..40),
    ) {
        let [multicast, binds, echoes, answers] = options;
        let mut world = World::new(config(if multicast { Transport::Multicast } else { UNICAST }));
        world.server.native = native;
        world.server.bitstream_status = bitstream_status;
        world.server.answers_echo = echoes;
        world.server.answers = answers;
        if !binds {
            world.server.models.clear();
        }
        let mut random = jitter(seed);
        world.network = Box::new(move |_| (random(loses_one_in) != 0).then_some(100_000));
        let mut number = 0;
        for (operation, span_ms, part_way) in steps {
            match operation {
                0 => world.server.answers = !world.server.answers,
                1 => world.session.close(),
                _ => {
                    number += 1;
                    world.frame(&Frame::at_rest(number));
                }
            }
            world.run(span_ms * MS);
            assert_idle_until_deadline(&world, part_way);
        }
    }
}
