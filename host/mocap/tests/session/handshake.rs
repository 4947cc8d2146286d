//! From the first CONNECT to the first frame, and back again.

use std::net::SocketAddr;

use singletrack_mocap::{
    Binding, Input, Phase, RestartReason, SessionConfigError, SessionEvent, Transport, UpAxis,
    codec::{BitstreamVersion, UnsupportedVersion},
    planar::{PlanarConfig, PlanarConfigError, PlanarEvent, PlanarSession, PoseState},
};

use crate::{CAR, Frame, MS, Outcome, S, SERVER, Sent, UNICAST, World, config, jitter};

#[test]
fn a_session_connects_binds_the_name_and_sees_the_car() {
    let mut world = World::connected(config(UNICAST));
    assert_eq!(
        world.session.source().phase(),
        Phase::Streaming(BitstreamVersion::V4_1)
    );
    assert_eq!(world.session.tracker().binding, Binding::Bound { id: CAR });
    assert_eq!(world.session.pose_state(world.now_ns), PoseState::NoFrames);
    assert!(matches!(
        world.next_state(&Frame::at_rest(1)),
        PoseState::Valid(_)
    ));
}

#[test]
fn connect_is_repeated_until_the_server_answers() {
    let mut world = World::new(config(UNICAST));
    world.server.answers = false;
    world.run(1_900 * MS);
    assert_eq!(world.count_sent(&Sent::Connect), 4);
    assert_eq!(world.session.source().phase(), Phase::Connecting);
    world.server.answers = true;
    world.run(200 * MS);
    assert_eq!(world.session.tracker().binding, Binding::Bound { id: CAR });
}

#[test]
fn a_network_that_loses_half_of_all_datagrams_only_delays_the_binding() {
    let mut world = World::new(config(UNICAST));
    world.server.native = [4, 4];
    let mut random = jitter(1);
    world.network = Box::new(move |_| (random(2) == 0).then_some(100_000));
    for number in 0..1_500 {
        world.run(10 * MS);
        world.frame(&Frame::at_rest(number));
    }
    assert!(matches!(
        world.session.source().phase(),
        Phase::Streaming(_)
    ));
    assert_eq!(world.session.tracker().binding, Binding::Bound { id: CAR });
}

#[test]
fn a_newer_server_is_asked_for_the_configured_bitstream() {
    let mut world = World::new(config(UNICAST));
    world.server.native = [4, 9];
    world.run(20 * MS);
    assert_eq!(
        world.count_sent(&Sent::Request("Bitstream,4.1".to_owned())),
        1
    );
    assert_eq!(
        world.session.source().phase(),
        Phase::Streaming(BitstreamVersion::V4_1)
    );
    assert!(matches!(
        world.next_state(&Frame::at_rest(1)),
        PoseState::Valid(_)
    ));
}

#[test]
fn the_bitstream_of_an_older_server_is_accepted() {
    for (native, version) in [
        ([3, 0], BitstreamVersion::V3_0),
        ([2, 9], BitstreamVersion::V2_9),
        ([2, 7], BitstreamVersion::V2_7),
    ] {
        let mut world = World::new(config(UNICAST));
        world.server.native = native;
        world.run(20 * MS);
        assert_eq!(world.session.source().phase(), Phase::Streaming(version));
        assert!(matches!(
            world.next_state(&Frame::at_rest(1)),
            PoseState::Valid(_)
        ));
    }
}

#[test]
fn a_server_that_keeps_a_supported_bitstream_is_read() {
    for status in [Some(1), None] {
        let mut world = World::new(config(UNICAST));
        world.server.native = [4, 3];
        world.server.bitstream_status = status;
        world.run(20 * MS);
        let kept = BitstreamVersion::new(4, 3).unwrap();
        assert_eq!(world.session.source().phase(), Phase::Streaming(kept));
        assert!(world.events.contains(&SessionEvent::BitstreamKept {
            requested: BitstreamVersion::V4_1,
            kept
        }));
    }
}

#[test]
fn an_unsupported_bitstream_is_refused_by_number_until_it_is_changed() {
    let mut world = World::new(config(UNICAST));
    world.server.native = [4, 5];
    world.server.bitstream_status = Some(1);
    world.run(3 * S);
    let refusal = UnsupportedVersion { major: 4, minor: 5 };
    assert_eq!(world.session.source().phase(), Phase::Refused(refusal));
    let reported = world
        .events
        .iter()
        .filter(|event| **event == SessionEvent::Refused(refusal))
        .count();
    assert_eq!(reported, 1);
    assert_eq!(world.frame(&Frame::at_rest(1)), Outcome::Ignored);
    assert_eq!(world.session.counters().session.early, 1);

    world.server.native = [4, 1];
    world.run(S);
    assert_eq!(
        world.session.source().phase(),
        Phase::Streaming(BitstreamVersion::V4_1)
    );
}

#[test]
fn a_server_before_2_7_is_refused_without_a_request() {
    let mut world = World::new(config(UNICAST));
    world.server.native = [2, 5];
    world.run(20 * MS);
    assert_eq!(
        world.session.source().phase(),
        Phase::Refused(UnsupportedVersion { major: 2, minor: 5 })
    );
    assert_eq!(world.sent.len(), 1);
}

#[test]
fn multicast_accepts_the_servers_bitstream_and_sends_no_keep_alive() {
    let mut world = World::new(config(Transport::Multicast));
    world.server.native = [4, 2];
    world.server.multicast = true;
    world.run(5 * S);
    assert_eq!(world.count_sent(&Sent::KeepAlive), 0);
    assert!(
        world
            .sent
            .iter()
            .all(|(_, sent)| !matches!(sent, Sent::Request(_)))
    );
    let version = BitstreamVersion::V4_2;
    assert!(world.events.iter().any(
        |event| matches!(event, SessionEvent::Connected(connected) if connected.version == version)
    ));

    let mut world = World::new(config(Transport::Multicast));
    world.server.native = [4, 5];
    world.run(20 * MS);
    assert_eq!(
        world.session.source().phase(),
        Phase::Refused(UnsupportedVersion { major: 4, minor: 5 })
    );
}

#[test]
fn a_server_with_the_other_transport_is_reported() {
    let mut world = World::new(config(UNICAST));
    world.server.multicast = true;
    world.run(20 * MS);
    assert!(world.events.contains(&SessionEvent::TransportMismatch {
        server_multicast: true
    }));
}

#[test]
fn keep_alive_and_echo_are_sent_at_their_rates() {
    let mut world = World::connected(config(UNICAST));
    for number in 0..1_000 {
        world.next_state(&Frame::at_rest(number));
    }
    world.sent.clear();
    for number in 1_000..2_000 {
        world.next_state(&Frame::at_rest(number));
    }
    assert_eq!(world.count_sent(&Sent::KeepAlive), 10);
    assert!((10..=20).contains(&world.count_sent(&Sent::Echo)));
    assert_eq!(world.count_sent(&Sent::Models), 2);
    assert_eq!(world.count_sent(&Sent::Connect), 0);
}

#[test]
fn frames_before_the_handshake_are_counted_and_dropped() {
    let mut world = World::new(config(UNICAST));
    assert_eq!(world.frame(&Frame::at_rest(1)), Outcome::Ignored);
    assert_eq!(world.session.counters().session.early, 1);
    assert_eq!(world.session.pose_state(world.now_ns), PoseState::NoFrames);
}

#[test]
fn a_datagram_from_another_address_is_counted_and_changes_nothing() {
    let mut world = World::connected(config(UNICAST));
    let bytes = world.encode(&Frame::at_rest(1));
    let stranger: SocketAddr = "192.168.1.66:1510".parse().unwrap();
    assert_eq!(world.receive_from(stranger, &bytes), Outcome::WrongSource);
    assert_eq!(world.session.counters().session.wrong_source, 1);
    assert_eq!(world.session.counters().session.frames, 0);
    assert_eq!(world.session.source().other_source(), Some(stranger.ip()));
    // The data port belongs to the server as well.
    let data_port = SocketAddr::new(SERVER.ip(), 1511);
    assert!(matches!(
        world.receive_from(data_port, &bytes),
        Outcome::Frame(_)
    ));
}

#[test]
fn the_session_connects_again_to_a_server_that_left() {
    let mut world = World::connected(config(UNICAST));
    world.next_state(&Frame::at_rest(1));
    let mut goodbye = [0; 4];
    singletrack_mocap::encode::disconnect(&mut goodbye).unwrap();
    world.receive(&goodbye);
    assert_eq!(world.session.source().phase(), Phase::Connecting);
    world.run(S);
    assert!(
        world
            .events
            .contains(&SessionEvent::Restarted(RestartReason::ServerLeft))
    );
    // Its numbers start again, as after any restart.
    assert!(matches!(
        world.next_state(&Frame::at_rest(0)),
        PoseState::Valid(_)
    ));
}

#[test]
fn a_closed_session_sends_disconnect_and_then_nothing() {
    let mut world = World::connected(config(UNICAST));
    world.sent.clear();
    world.session.close();
    assert_eq!(world.session.poll_timeout(), Some(0));
    world.run(10 * S);
    let sent: Vec<_> = world.sent.iter().map(|(_, sent)| sent.clone()).collect();
    assert_eq!(sent, [Sent::Disconnect]);
    assert_eq!(world.session.source().phase(), Phase::Closed);
    assert_eq!(world.session.poll_timeout(), None);
}

#[test]
fn an_invalid_configuration_is_refused_with_the_fields_name() {
    let new = |name: &str| PlanarConfig::new(SERVER.ip(), UNICAST, name, UpAxis::Y).map(drop);
    assert_eq!(new(""), Err(PlanarConfigError::RigidBodyName { len: 0 }));
    assert_eq!(
        new(&"x".repeat(256)),
        Err(PlanarConfigError::RigidBodyName { len: 256 })
    );
    let mut bad = config(UNICAST);
    bad.limits.max_speed_m_s = -1.0;
    assert_eq!(
        PlanarSession::new(bad).map(drop).unwrap_err(),
        PlanarConfigError::Session(SessionConfigError::NotPositive {
            key: "max_speed_m_s",
            value: -1.0
        })
    );
    let mut bad = config(UNICAST);
    bad.session.timing.echo_ns = 0;
    assert_eq!(
        PlanarSession::new(bad).map(drop).unwrap_err(),
        PlanarConfigError::Session(SessionConfigError::Zero { key: "echo_ns" })
    );
}

#[test]
fn another_address_is_reported_once_for_each_and_its_datagrams_are_counted() {
    let mut world = World::connected(config(UNICAST));
    let bytes = world.encode(&Frame::at_rest(1));
    let mut reported = vec![];
    for _ in 0..3 {
        for host in [66, 67, 68, 69, 70, 71] {
            let stranger = SocketAddr::from(([192, 168, 1, host], 1510));
            let input = Input::Datagram {
                source: stranger,
                bytes: &bytes,
            };
            world
                .session
                .handle_input(world.now_ns, input, &mut |event| reported.push(event));
        }
    }
    assert_eq!(world.session.counters().session.wrong_source, 18);
    // Someone who changes the address with every datagram does not fill the log.
    let expected: Vec<_> = [66, 67, 68, 69]
        .map(|host| PlanarEvent::Session(SessionEvent::OtherSource([192, 168, 1, host].into())))
        .into();
    assert_eq!(reported, expected);
}
