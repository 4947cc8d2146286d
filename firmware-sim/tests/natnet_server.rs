//! The datagrams of the simulated cameras, checked with two decoders.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::net::SocketAddr;

use natnet::{Decoder, Message, Version};
use singletrack_mocap::{
    codec::{BitstreamVersion, ClientMessage, Connect, Response, ServerMessage},
    encode,
};
use singletrack_sim::{Destination, LossKind, SimulationConfig, TICKS_PER_SECOND, World};

const CLIENT: &str = "127.0.0.1:40001";

fn client() -> SocketAddr {
    CLIENT.parse().unwrap()
}

fn world(bitstream: BitstreamVersion) -> World {
    let mut config = SimulationConfig::default();
    config.natnet.bitstream = bitstream;
    World::new(config).unwrap()
}

fn ask(world: &mut World, message: &ClientMessage<'_>) -> Option<Vec<u8>> {
    let mut buffer = [0; 1024];
    let length = encode::client_message(message, &mut buffer).unwrap();
    while world.poll_datagram().is_some() {}
    world.handle_datagram(client(), &buffer[..length]);
    let datagram = world.poll_datagram()?;
    assert_eq!(datagram.to, Destination::Client(client()));
    assert!(!datagram.is_frame);
    Some(datagram.bytes)
}

const CONNECT: ClientMessage<'_> = ClientMessage::Connect(Connect {
    name: "test",
    requested_bitstream: None,
});

fn frames(world: &mut World, ms: u64) -> Vec<Vec<u8>> {
    world.advance_to(world.now_us + ms * 1_000);
    core::iter::from_fn(|| world.poll_datagram())
        .filter(|datagram| datagram.is_frame)
        .map(|datagram| datagram.bytes)
        .collect()
}

#[test]
fn an_independent_decoder_agrees_with_ours() {
    for version in [BitstreamVersion::V3_0, BitstreamVersion::V4_1] {
        let mut world = world(version);
        let [major, minor, build, revision] = version.to_wire();
        let decoder = Decoder::new(Version::new(major, minor, build, revision)).unwrap();

        let info = ask(&mut world, &CONNECT).unwrap();
        let Message::ServerInfo(theirs) = decoder.parse(&info).unwrap().into_message() else {
            panic!("not a SERVERINFO");
        };
        assert_eq!(theirs.high_res_clock_frequency, TICKS_PER_SECOND);
        assert_eq!(theirs.protocol_version.major, major);
        let Ok(ServerMessage::ServerInfo(ours)) = ServerMessage::decode(&info, version) else {
            panic!("not a SERVERINFO");
        };
        assert_eq!(ours.bitstream(), Ok(version));
        assert_eq!(ours.application, theirs.application_name);

        let models = ask(&mut world, &ClientMessage::RequestModelDefinitions).unwrap();
        let Message::ModelDef(theirs) = decoder.parse(&models).unwrap().into_message() else {
            panic!("not a MODELDEF");
        };
        assert_eq!(theirs.resolve_rigid_body("car"), Some(11));
        assert_eq!(theirs.rigid_bodies().count(), 3);
        let Ok(ServerMessage::ModelDefinitions(ours)) = ServerMessage::decode(&models, version)
        else {
            panic!("not a MODELDEF");
        };
        let ours: Vec<_> = ours
            .rigid_bodies()
            .map(|body| (str::from_utf8(body.name).unwrap(), body.id))
            .collect();
        assert_eq!(ours, theirs.rigid_bodies().collect::<Vec<_>>());

        let frames = frames(&mut world, 1_000);
        assert_eq!(frames.len(), 99);
        for datagram in &frames {
            let Message::FrameOfData(theirs) = decoder.parse(datagram).unwrap().into_message()
            else {
                panic!("not a frame");
            };
            let Ok(ServerMessage::Frame(ours)) = ServerMessage::decode(datagram, version) else {
                panic!("not a frame");
            };
            assert_eq!(ours.number, theirs.frame_number);
            let ticks = ours.ticks.unwrap();
            assert_eq!(ticks.mid_exposure, theirs.timing.camera_mid_exposure);
            assert_eq!(ticks.transmit, theirs.timing.transmit);
            let bodies: Vec<_> = ours.rigid_bodies().collect();
            assert_eq!(bodies.len(), theirs.rigid_bodies.len());
            for (ours, theirs) in bodies.iter().zip(&theirs.rigid_bodies) {
                assert_eq!(ours.id, theirs.id);
                assert_eq!(ours.position_m, theirs.position);
                assert_eq!(ours.orientation_xyzw, theirs.orientation);
                assert_eq!(ours.tracking_valid(), theirs.tracking_valid());
            }
        }
    }
}

#[test]
fn a_client_can_request_another_bitstream() {
    let mut world = world(BitstreamVersion::V4_1);
    ask(&mut world, &CONNECT).unwrap();
    let answer = ask(&mut world, &ClientMessage::Request("Bitstream,3.0")).unwrap();
    let version = BitstreamVersion::V3_0;
    assert!(matches!(
        ServerMessage::decode(&answer, version),
        Ok(ServerMessage::Response(Response::Status(0)))
    ));
    let frames = frames(&mut world, 50);
    assert!(!frames.is_empty());
    for frame in frames {
        assert!(ServerMessage::decode(&frame, version).is_ok());
        assert!(ServerMessage::decode(&frame, BitstreamVersion::V4_1).is_err());
    }
    let answer = ask(&mut world, &ClientMessage::Request("Bitstream,9.9")).unwrap();
    assert!(matches!(
        ServerMessage::decode(&answer, version),
        Ok(ServerMessage::Response(Response::Status(1)))
    ));
}

#[test]
fn a_silent_unicast_client_is_dropped() {
    let mut world = world(BitstreamVersion::V4_1);
    assert!(
        frames(&mut world, 100).is_empty(),
        "no client has connected"
    );
    ask(&mut world, &CONNECT).unwrap();
    for _ in 0..10 {
        assert_eq!(frames(&mut world, 1_000).len(), 100);
        assert_eq!(ask(&mut world, &ClientMessage::KeepAlive), None);
    }
    // Five seconds after the last keep-alive.
    assert_eq!(frames(&mut world, 8_000).len(), 500);
    assert_eq!(world.natnet.counters.expired, 1);
    assert_eq!(world.natnet.clients().count(), 0);
    ask(&mut world, &CONNECT).unwrap();
    assert_eq!(frames(&mut world, 100).len(), 10);
    assert_eq!(ask(&mut world, &ClientMessage::Disconnect), None);
    assert!(frames(&mut world, 100).is_empty());
}

#[test]
fn an_echo_returns_the_servers_clock() {
    let mut world = world(BitstreamVersion::V4_1);
    let mut echo = |at_us: u64| {
        world.advance_to(at_us);
        let request = ClientMessage::EchoRequest { client_stamp: 77 };
        let bytes = ask(&mut world, &request).unwrap();
        match ServerMessage::decode(&bytes, BitstreamVersion::V4_1) {
            Ok(ServerMessage::Echo(echo)) => {
                assert_eq!(echo.client_stamp, 77);
                echo.server_ticks
            }
            other => panic!("{other:?}"),
        }
    };
    let (first, second) = (echo(1_000_000), echo(11_000_000));
    // 40 ppm fast.
    assert_eq!(second - first, 100_004_000);
}

#[test]
fn multicast_frames_go_to_the_group_without_a_client() {
    let mut config = SimulationConfig::default();
    config.natnet.multicast = true;
    let mut world = World::new(config).unwrap();
    world.advance_to(100_000);
    let to: Vec<_> = core::iter::from_fn(|| world.poll_datagram())
        .map(|datagram| datagram.to)
        .collect();
    assert_eq!(to, [Destination::Group; 9]);
}

#[test]
fn corrupted_requests_are_counted_and_answered_as_unrecognised() {
    let mut world = world(BitstreamVersion::V4_1);
    for bytes in [&[][..], &[0], &[255; 3], &[0, 0, 255, 255], &[9; 2000]] {
        world.handle_datagram(client(), bytes);
        let answer = world.poll_datagram().unwrap();
        assert_eq!(answer.bytes[..2], 100_u16.to_le_bytes());
    }
    assert_eq!(world.natnet.counters.malformed, 5);
    assert_eq!(world.natnet.clients().count(), 0);
}

#[test]
fn a_new_streaming_id_is_announced_and_in_the_models() {
    let mut world = world(BitstreamVersion::V4_1);
    ask(&mut world, &CONNECT).unwrap();
    frames(&mut world, 50);
    world.set_car_body_id(42);
    let changed: Vec<bool> = frames(&mut world, 50)
        .iter()
        .map(
            |bytes| match ServerMessage::decode(bytes, BitstreamVersion::V4_1) {
                Ok(ServerMessage::Frame(frame)) => frame
                    .flags
                    .contains(singletrack_mocap::codec::FrameFlags::MODELS_CHANGED),
                other => panic!("{other:?}"),
            },
        )
        .collect();
    assert_eq!(changed.iter().filter(|changed| **changed).count(), 1);
    let models = ask(&mut world, &ClientMessage::RequestModelDefinitions).unwrap();
    match ServerMessage::decode(&models, BitstreamVersion::V4_1) {
        Ok(ServerMessage::ModelDefinitions(models)) => {
            assert!(
                models
                    .rigid_bodies()
                    .any(|body| (body.name, body.id) == (&b"car"[..], 42))
            );
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_kind_of_loss_has_its_form_on_the_wire() {
    for (kind, bodies, sent) in [
        (LossKind::Occluded, 3, true),
        (LossKind::Absent, 2, true),
        (LossKind::Silent, 0, false),
    ] {
        let mut world = world(BitstreamVersion::V4_1);
        ask(&mut world, &CONNECT).unwrap();
        frames(&mut world, 50);
        world.cameras.faults.loss = Some(kind);
        // Frames in transit before the loss.
        frames(&mut world, 20);
        let frames = frames(&mut world, 100);
        assert_eq!(frames.len(), if sent { 10 } else { 0 });
        for bytes in &frames {
            match ServerMessage::decode(bytes, BitstreamVersion::V4_1) {
                Ok(ServerMessage::Frame(frame)) => {
                    assert_eq!(frame.rigid_bodies().count(), bodies);
                    assert!(
                        frame
                            .rigid_bodies()
                            .all(|body| body.id != 11 || !body.tracking_valid())
                    );
                }
                other => panic!("{other:?}"),
            }
        }
    }
}
