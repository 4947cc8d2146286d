//! The camera session by itself: whole poses of every body, and the streaming id of a body's name.

use std::{f64::consts::FRAC_1_SQRT_2, num::NonZeroU64};

use singletrack_mocap::{
    Binding, BodyPose, BodyState, CaptureTimeSource, Input, InvalidBody, Output, PoseFrame,
    PoseSource as _, Session, SessionConfig, SessionEvent, UpAxis,
    codec::{
        BitstreamVersion, CameraTicks, ClientMessage, Connection, DataChannel, Echo, FrameFlags,
        RigidBody, RigidBodyDefinition, ServerInfo,
    },
    encode::{self, Dataset, EncodeError, FrameContent},
    planar::PoseState,
};

use crate::{CAR, Frame, MS, S, SERVER, TICKS_PER_SECOND, UNICAST, World, car_at, config};

const VERSION: BitstreamVersion = BitstreamVersion::V4_1;

/// A session that streams, and its server.
struct Bench {
    session: Session,
    now_ns: u64,
    number: i32,
    events: Vec<SessionEvent>,
    buffer: Vec<u8>,
}

impl Bench {
    fn streaming(up_axis: UpAxis) -> Self {
        let mut bench = Self {
            session: Session::new(SessionConfig::new(SERVER.ip(), UNICAST, up_axis)).unwrap(),
            now_ns: 1_000 * MS,
            number: 0,
            events: vec![],
            buffer: vec![0; 65_536],
        };
        let info = ServerInfo {
            application: "Scripted",
            application_version: [1, 0, 0, 0],
            natnet_version: VERSION.to_wire(),
            connection: Some(Connection {
                ticks_per_second: NonZeroU64::new(TICKS_PER_SECOND),
                data_channel: DataChannel {
                    port: 1511,
                    multicast: false,
                    group: std::net::Ipv4Addr::new(239, 255, 42, 99),
                },
            }),
        };
        bench.reply(|out| encode::server_info(&info, out));
        bench.answer_echo();
        bench
    }

    fn ticks(local_ns: u64) -> u64 {
        local_ns / (1_000_000_000 / TICKS_PER_SECOND)
    }

    fn reply(&mut self, encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>) {
        let len = encode(&mut self.buffer).unwrap();
        self.receive(len, &mut |_| {});
    }

    /// Hands over the first bytes of the buffer. Events are kept.
    fn receive(&mut self, len: usize, on_output: &mut dyn FnMut(Output<'_>)) {
        let input = Input::Datagram {
            source: SERVER,
            bytes: &self.buffer[..len],
        };
        let events = &mut self.events;
        self.session
            .handle_input(self.now_ns, input, &mut |output| match output {
                Output::Event(event) => events.push(event),
                output => on_output(output),
            });
    }

    fn answer_echo(&mut self) {
        while let Some(transmit) = self.session.poll_transmit(self.now_ns) {
            if let Ok(ClientMessage::EchoRequest { client_stamp }) =
                ClientMessage::decode(&transmit.bytes)
            {
                let server_ticks = Self::ticks(self.now_ns + MS / 10);
                self.now_ns += MS / 5;
                let echo = Echo {
                    client_stamp,
                    server_ticks,
                };
                self.reply(|out| encode::echo_response(echo, out));
            }
        }
    }

    /// A frame that was captured 8 ms before it arrives, without flags.
    fn frame<T>(&mut self, bodies: &[RigidBody], of: impl Fn(&PoseFrame<'_>) -> T) -> T {
        self.flagged(bodies, FrameFlags::default(), of)
    }

    fn flagged<T>(
        &mut self,
        bodies: &[RigidBody],
        flags: FrameFlags,
        of: impl Fn(&PoseFrame<'_>) -> T,
    ) -> T {
        self.now_ns += 10 * MS;
        self.number += 1;
        let content = FrameContent {
            number: self.number,
            rigid_bodies: bodies,
            timestamp_s: self.now_ns as f64 * 1e-9,
            ticks: CameraTicks {
                mid_exposure: Self::ticks(self.now_ns - 8 * MS),
                received: Self::ticks(self.now_ns - MS),
                transmit: Self::ticks(self.now_ns - MS),
            },
            flags,
            ..FrameContent::default()
        };
        let len = encode::frame(VERSION, &content, &mut self.buffer).unwrap();
        let mut found = None;
        self.receive(len, &mut |output| match output {
            Output::Frame(frame) => found = Some(of(&frame)),
            other => panic!("not a frame: {other:?}"),
        });
        found.unwrap()
    }
}

#[track_caller]
fn tracked(state: BodyState) -> BodyPose {
    match state {
        BodyState::Tracked(pose) => pose,
        other => panic!("not tracked: {other:?}"),
    }
}

#[test]
fn a_frame_carries_the_whole_pose_of_every_body() {
    let mut bench = Bench::streaming(UpAxis::Z);
    let bodies: Vec<_> = (0_i16..40)
        .map(|id| {
            let mut body =
                RigidBody::tracked(id.into(), [id.into(), 0.5, -2.0], [0.5, 0.5, 0.5, 0.5]);
            body.mean_error_m = 0.25;
            body.with_tracking_valid(id != 7)
        })
        .collect();
    let arrival_ns = bench.now_ns + 10 * MS;
    bench.frame(&bodies, |frame| {
        assert_eq!(frame.bodies().len(), 40);
        for body in frame.bodies() {
            if body.id == 7 {
                assert_eq!(body.state, BodyState::Untracked);
            } else {
                let pose = tracked(body.state);
                assert_eq!(pose.position_m, [f64::from(body.id), 0.5, -2.0]);
                assert_eq!(pose.orientation_xyzw, [0.5; 4]);
                assert_eq!(pose.mean_error_m, 0.25);
            }
        }
        let capture = frame.capture.unwrap();
        assert_eq!(frame.receive_time_ns, arrival_ns);
        assert_eq!(capture.source, CaptureTimeSource::MidExposureEcho);
        let error_ns = capture.time_ns.abs_diff(arrival_ns - 8 * MS);
        assert!(error_ns <= capture.uncertainty_ns, "{error_ns} ns");
        assert_eq!(frame.body(12).unwrap().id, 12);
        assert_eq!(frame.body(40), None);
    });
}

#[test]
fn y_up_turns_the_whole_quaternion() {
    let mut bench = Bench::streaming(UpAxis::Y);
    // A quarter turn about the stream's z axis is one about the world's -y axis.
    let half = FRAC_1_SQRT_2 as f32;
    let body = RigidBody::tracked(1, [1.0, 2.0, 3.0], [0.0, 0.0, half, half]);
    let pose = bench.frame(&[body], |frame| tracked(frame.body(1).unwrap().state));
    assert_eq!(pose.position_m, [1.0, -3.0, 2.0]);
    let expected = [0.0, -FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2];
    for (actual, expected) in pose.orientation_xyzw.iter().zip(expected) {
        assert!(
            (actual - expected).abs() < 1e-7,
            "{actual} is not {expected}"
        );
    }
}

#[test]
fn a_quaternion_is_normalised_or_refused() {
    let mut bench = Bench::streaming(UpAxis::Z);
    let rotation = |w| RigidBody::tracked(1, [0.0; 3], [0.0, 0.0, 0.0, w]);
    let pose = bench.frame(&[rotation(1.009)], |frame| {
        tracked(frame.body(1).unwrap().state)
    });
    assert_eq!(pose.orientation_xyzw, [0.0, 0.0, 0.0, 1.0]);
    for (body, invalid) in [
        (rotation(1.02), InvalidBody::NotUnitQuaternion),
        (rotation(f32::NAN), InvalidBody::NotFinite),
        (
            RigidBody::tracked(1, [f32::INFINITY; 3], [0.0, 0.0, 0.0, 1.0]),
            InvalidBody::NotFinite,
        ),
    ] {
        let state = bench.frame(&[body], |frame| frame.body(1).unwrap().state);
        assert_eq!(state, BodyState::Invalid(invalid));
    }
}

#[test]
fn two_bodies_with_one_id_have_no_pose_by_id() {
    let mut bench = Bench::streaming(UpAxis::Z);
    let body = RigidBody::tracked(1, [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    bench.frame(&[body, body.with_tracking_valid(false)], |frame| {
        assert_eq!(
            frame.body(1).unwrap().state,
            BodyState::Invalid(InvalidBody::DuplicateId)
        );
        assert_eq!(frame.bodies().count(), 2);
    });
}

#[test]
fn names_are_current_from_the_definitions_to_the_next_change_of_models() {
    let mut bench = Bench::streaming(UpAxis::Z);
    let is_current = |frame: &PoseFrame<'_>| frame.definitions_current;
    assert!(!bench.frame(&[], is_current));
    let datasets = [("car", 7), ("trailer", 8)].map(|(name, id)| {
        Dataset::RigidBody(RigidBodyDefinition {
            name: name.as_bytes(),
            id,
            parent_id: -1,
            offset_m: [0.0; 3],
        })
    });
    let len = encode::model_definitions(VERSION, &datasets, &mut bench.buffer).unwrap();
    let mut bindings = None;
    bench.receive(len, &mut |output| {
        let Output::Names(names) = output else {
            panic!("no definitions: {output:?}");
        };
        bindings = Some(["trailer", "Car"].map(|name| Binding::resolve(&names, name)));
    });
    assert_eq!(bindings, Some([Binding::Bound { id: 8 }, Binding::Missing]));
    assert!(bench.frame(&[], is_current));

    bench.events.clear();
    assert!(!bench.flagged(&[], FrameFlags::MODELS_CHANGED, is_current));
    assert_eq!(bench.events, [SessionEvent::DefinitionsOutdated]);
    assert!(!bench.session.definitions_current());
}

#[test]
fn a_missing_name_is_a_state_until_the_name_appears() {
    let mut world = World::new(config(UNICAST));
    world.server.models = vec![("other", 3), ("Car", CAR)];
    world.run(20 * MS);
    assert_eq!(world.session.tracker().binding, Binding::Missing);
    assert_eq!(
        world.session.tracker().names.to_string(),
        r#""other", "Car""#
    );
    assert_eq!(
        world.next_state(&Frame::at_rest(1)),
        PoseState::Unbound(Binding::Missing)
    );
    assert_eq!(world.session.counters().unbound, 1);
    world.server.models.push(("car", 12));
    world.run(600 * MS);
    assert_eq!(world.session.tracker().binding, Binding::Bound { id: 12 });
}

#[test]
fn a_name_of_two_bodies_is_ambiguous() {
    let mut world = World::new(config(UNICAST));
    world.server.models = vec![("car", 1), ("other", 3), ("car", CAR)];
    world.run(20 * MS);
    let ambiguous = Binding::Ambiguous { count: 2 };
    assert_eq!(world.session.tracker().binding, ambiguous);
    assert!(world.bindings.contains(&ambiguous));
    assert_eq!(
        world.next_state(&Frame::at_rest(1)),
        PoseState::Unbound(ambiguous)
    );
}

/// Another body has the car's former id.
fn after_swap(number: i32) -> Frame {
    let mut other = car_at(0.02, 0.0);
    other.id = CAR;
    let mut car = car_at(0.0, 0.0);
    car.id = 8;
    Frame::new(number, &[other, car])
}

#[test]
fn ids_that_change_with_the_flag_never_yield_another_bodys_pose() {
    let mut world = World::connected(config(UNICAST));
    world.next_state(&Frame::at_rest(1));
    world.server.models = vec![("other", CAR), ("car", 8)];
    let mut changed = after_swap(2);
    changed.flags = FrameFlags::MODELS_CHANGED;
    assert_eq!(
        world.next_state(&changed),
        PoseState::Unbound(Binding::Unresolved)
    );
    // The flag may stay set: the definitions are read once at once, then slowly.
    for number in 3..20 {
        let mut frame = after_swap(number);
        frame.flags = FrameFlags::MODELS_CHANGED;
        let state = world.next_state(&frame);
        let PoseState::Valid(pose) = state else {
            panic!("{state:?}");
        };
        assert!(pose.x_m.abs() < 1e-9, "the other body's pose");
    }
}

#[test]
fn ids_that_change_without_the_flag_are_noticed_by_polling() {
    let mut world = World::connected(config(UNICAST));
    world.server.models = vec![("other", CAR), ("car", 8)];
    for number in 0..600 {
        world.next_state(&after_swap(number));
    }
    assert_eq!(world.session.tracker().binding, Binding::Bound { id: 8 });
}

#[test]
fn lost_definitions_are_soon_requested_again() {
    let mut world = World::connected(config(UNICAST));
    world.server.answers = false;
    let mut changed = Frame::at_rest(1);
    changed.flags = FrameFlags::MODELS_CHANGED;
    world.next_state(&changed);
    world.run(50 * MS);
    world.server.answers = true;
    world.run(110 * MS);
    assert_eq!(world.session.tracker().binding, Binding::Bound { id: CAR });
}

#[test]
fn a_damaged_definition_is_counted_and_leaves_the_binding() {
    let mut world = World::connected(config(UNICAST));
    world.receive(&[5, 0, 4, 0, 1, 0, 0, 0]);
    assert_eq!(world.session.counters().session.malformed, 1);
    assert_eq!(world.session.tracker().binding, Binding::Bound { id: CAR });
    world.run(S);
    let body = RigidBody::tracked(CAR, [0.0; 3], [0.0, 0.0, 0.0, 1.0]);
    assert!(matches!(
        world.next_state(&Frame::new(1, &[body])),
        PoseState::Valid(_)
    ));
}

#[test]
fn of_many_names_the_first_are_listed_and_the_others_counted() {
    let mut world = World::new(config(UNICAST));
    assert!(world.session.tracker().names.is_empty());
    world.server.models = vec![("a\u{1b}[2J", 1); 1];
    world
        .server
        .models
        .extend([("twenty-five-bytes-of-name", 2); 20]);
    world.run(20 * MS);
    let names = world.session.tracker().names.to_string();
    // What a terminal would obey is escaped.
    assert!(
        names.starts_with(r#""a\u{1b}[2J", "twenty-five"#),
        "{names}"
    );
    assert!(names.ends_with("\" and 13 more"), "{names}");
    let names = &world.session.tracker().names;
    assert_eq!(names.name(1), Some(r#""a\u{1b}[2J""#));
    assert_eq!(names.name(2), Some(r#""twenty-five-bytes-of-name""#));
    assert_eq!(names.name(3), None);
}
