//! Two senders with the server's address.

use std::net::SocketAddr;

use singletrack_mocap::{RejectReason, SessionEvent, planar::PoseState};

use crate::world::{
    Frame, MS, Outcome, S, SERVER, TICKS_PER_SECOND, UNICAST, World, car_at, config,
};

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
    assert!(world.session.is_contradicted(world.now_ns));
    assert!(matches!(
        world.session.pose_state(world.now_ns),
        PoseState::LockedOut(RejectReason::CaptureTime)
    ));
    // A second without contradictions restores the trust.
    for number in 151..=300 {
        world.next_state(&Frame::at_rest(number));
    }
    assert!(!world.session.is_contradicted(world.now_ns));
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
