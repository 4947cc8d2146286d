//! The sessions in virtual time, against a scripted server.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "test helpers fail the test that calls them"
)]

mod bodies;
mod clock;
mod handshake;
mod poses;
mod stream;

use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    num::NonZeroU64,
};

use singletrack_mocap::{
    Binding, Input, SessionCounters, SessionEvent, Transport, UpAxis,
    codec::{
        BitstreamVersion, CameraTicks, ClientMessage, Connection, DataChannel, Echo, FrameFlags,
        RigidBody, RigidBodyDefinition, ServerInfo, bitstream_request,
    },
    encode::{self, Dataset, FrameContent},
    planar::{Observation, OtherBody, PlanarConfig, PlanarEvent, PlanarSession, PoseState},
};

pub(crate) const MS: u64 = 1_000_000;
pub(crate) const S: u64 = 1_000 * MS;

pub(crate) const SERVER: SocketAddr =
    SocketAddr::new(IpAddr::V4(Ipv4Addr::new(192, 168, 1, 10)), 1510);

pub(crate) const CAR: i32 = 7;

pub(crate) const UNICAST: Transport = Transport::Unicast {
    bitstream: Some(BitstreamVersion::V4_1),
};

pub(crate) fn config(transport: Transport) -> PlanarConfig {
    PlanarConfig::new(SERVER.ip(), transport, "car", UpAxis::Z).unwrap()
}

/// The scripted server.
pub(crate) struct Server {
    /// Its own bitstream: major, minor.
    pub(crate) native: [u8; 2],
    /// Status answered to a bitstream request; `None` answers "unrecognized".
    pub(crate) bitstream_status: Option<i32>,
    pub(crate) multicast: bool,
    /// Whether it answers at all.
    pub(crate) answers: bool,
    pub(crate) answers_echo: bool,
    pub(crate) models: Vec<(&'static str, i32)>,
    /// The bitstream of frames and definitions.
    pub(crate) stream: BitstreamVersion,
    /// Ticks shown at local time 0, and the rate error of its clock.
    pub(crate) ticks_at_zero: u64,
    pub(crate) skew_ppm: f64,
}

pub(crate) const TICKS_PER_SECOND: u64 = 10_000_000;

impl Server {
    fn ticks_at(&self, local_ns: u64) -> u64 {
        let elapsed_s = local_ns as f64 * 1e-9 * (1.0 + self.skew_ppm * 1e-6);
        self.ticks_at_zero + (elapsed_s * TICKS_PER_SECOND as f64) as u64
    }

    fn answer(&mut self, message: &ClientMessage<'_>, local_ns: u64) -> Option<Vec<u8>> {
        let mut out = vec![0; 4096];
        let [major, minor] = self.native;
        let len = match message {
            ClientMessage::Connect(_) => {
                if let Ok(native) = BitstreamVersion::new(major, minor) {
                    self.stream = native;
                }
                let connection = (major >= 3).then_some(Connection {
                    ticks_per_second: NonZeroU64::new(TICKS_PER_SECOND),
                    data_channel: DataChannel {
                        port: 1511,
                        multicast: self.multicast,
                        group: Ipv4Addr::new(239, 255, 42, 99),
                    },
                });
                let info = ServerInfo {
                    application: "Scripted",
                    application_version: [1, 0, 0, 0],
                    natnet_version: [major, minor, 0, 0],
                    connection,
                };
                encode::server_info(&info, &mut out)
            }
            ClientMessage::Request(text) => {
                if self.bitstream_status == Some(0)
                    && let Some(Ok(version)) = bitstream_request(text)
                {
                    self.stream = version;
                }
                match self.bitstream_status {
                    Some(status) => encode::response_status(status, &mut out),
                    None => encode::unrecognized(&mut out),
                }
            }
            ClientMessage::RequestModelDefinitions => {
                let datasets: Vec<_> = self
                    .models
                    .iter()
                    .map(|(name, id)| {
                        Dataset::RigidBody(RigidBodyDefinition {
                            name: name.as_bytes(),
                            id: *id,
                            parent_id: -1,
                            offset_m: [0.0; 3],
                        })
                    })
                    .collect();
                encode::model_definitions(self.stream, &datasets, &mut out)
            }
            ClientMessage::EchoRequest { client_stamp } if self.answers_echo => {
                let echo = Echo {
                    client_stamp: *client_stamp,
                    server_ticks: self.ticks_at(local_ns),
                };
                encode::echo_response(echo, &mut out)
            }
            _ => return None,
        };
        out.truncate(len.unwrap());
        self.answers.then_some(out)
    }
}

/// The part of a client's message that tests check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Sent {
    Connect,
    Request(String),
    Models,
    KeepAlive,
    Echo,
    Disconnect,
}

/// The travel time of a datagram; `None` loses it. The flag means "to the server".
pub(crate) type Network = Box<dyn FnMut(bool) -> Option<u64>>;

pub(crate) struct World {
    pub(crate) now_ns: u64,
    pub(crate) session: PlanarSession,
    pub(crate) server: Server,
    pub(crate) network: Network,
    /// Arrival time and bytes of the datagrams on their way to the client.
    in_flight: Vec<(u64, Vec<u8>)>,
    /// What the session sent, with its time.
    pub(crate) sent: Vec<(u64, Sent)>,
    pub(crate) events: Vec<SessionEvent>,
    /// Events about the body's name.
    pub(crate) bindings: Vec<Binding>,
    pub(crate) observations: Vec<Observation>,
    pub(crate) others: Vec<OtherBody>,
}

impl World {
    pub(crate) fn new(config: PlanarConfig) -> Self {
        Self {
            now_ns: 1_000 * S,
            session: PlanarSession::new(config).unwrap(),
            server: Server {
                native: [4, 1],
                bitstream_status: Some(0),
                multicast: false,
                answers: true,
                answers_echo: true,
                models: vec![("other", 3), ("car", CAR)],
                stream: BitstreamVersion::V4_1,
                ticks_at_zero: 500_000 * TICKS_PER_SECOND,
                skew_ppm: 0.0,
            },
            network: Box::new(|_| Some(100_000)),
            in_flight: vec![],
            sent: vec![],
            events: vec![],
            bindings: vec![],
            observations: vec![],
            others: vec![],
        }
    }

    /// A world whose session is connected and bound.
    pub(crate) fn connected(config: PlanarConfig) -> Self {
        let mut world = Self::new(config);
        world.run(20 * MS);
        world
    }

    /// Lets time pass.
    pub(crate) fn run(&mut self, duration_ns: u64) {
        let end_ns = self.now_ns + duration_ns;
        loop {
            self.drain();
            let arrival_ns = self.in_flight.iter().map(|(at_ns, _)| *at_ns).min();
            let timeout_ns = self.session.poll_timeout();
            if let Some(timeout_ns) = timeout_ns {
                assert!(timeout_ns > self.now_ns, "a timeout that never passes");
            }
            let next_ns = [arrival_ns, timeout_ns].into_iter().flatten().min();
            match next_ns {
                Some(next_ns) if next_ns <= end_ns => self.now_ns = self.now_ns.max(next_ns),
                _ => break,
            }
            self.deliver();
        }
        self.now_ns = end_ns;
    }

    fn drain(&mut self) {
        let (events, bindings) = (&mut self.events, &mut self.bindings);
        self.session
            .handle_timeout(self.now_ns, &mut |event| keep(event, events, bindings));
        while let Some(datagram) = self.session.poll_transmit(self.now_ns) {
            assert_eq!(datagram.destination, SERVER);
            let message = ClientMessage::decode(&datagram.bytes).unwrap();
            let sent = match message {
                ClientMessage::Connect(_) => Sent::Connect,
                ClientMessage::Request(text) => Sent::Request(text.to_owned()),
                ClientMessage::RequestModelDefinitions => Sent::Models,
                ClientMessage::KeepAlive => Sent::KeepAlive,
                ClientMessage::EchoRequest { .. } => Sent::Echo,
                ClientMessage::Disconnect => Sent::Disconnect,
                other => panic!("sent {other:?}"),
            };
            self.sent.push((self.now_ns, sent));
            let Some(there_ns) = (self.network)(true) else {
                continue;
            };
            let at_server_ns = self.now_ns + there_ns;
            if let Some(answer) = self.server.answer(&message, at_server_ns)
                && let Some(back_ns) = (self.network)(false)
            {
                self.in_flight.push((at_server_ns + back_ns, answer));
            }
        }
    }

    fn deliver(&mut self) {
        let now_ns = self.now_ns;
        let (due, rest): (Vec<_>, Vec<_>) = std::mem::take(&mut self.in_flight)
            .into_iter()
            .partition(|(at_ns, _)| *at_ns <= now_ns);
        self.in_flight = rest;
        for (_, bytes) in due {
            self.receive(&bytes);
        }
    }

    /// Hands a datagram of the server to the session now.
    pub(crate) fn receive(&mut self, bytes: &[u8]) -> Outcome {
        self.receive_from(SERVER, bytes)
    }

    /// Hands a datagram to the session now. What became of it is in the counters.
    pub(crate) fn receive_from(&mut self, source: SocketAddr, bytes: &[u8]) -> Outcome {
        let before = self.session.counters().session;
        let mut observed = None;
        let (events, bindings) = (&mut self.events, &mut self.bindings);
        let others = &mut self.others;
        let input = Input::Datagram { source, bytes };
        self.session
            .handle_input(self.now_ns, input, &mut |event| match event {
                PlanarEvent::Observed(observation) => observed = Some(observation),
                PlanarEvent::Other(other) => others.push(other),
                event => keep(event, events, bindings),
            });
        if let Some(observation) = observed {
            self.observations.push(observation);
            return Outcome::Frame(observation);
        }
        let after = self.session.counters().session;
        let grew = |count: fn(&SessionCounters) -> u64| count(&after) > count(&before);
        if grew(|counters| counters.duplicates) {
            Outcome::Duplicate
        } else if grew(|counters| counters.late + counters.contradictions) {
            Outcome::Late
        } else if grew(|counters| counters.malformed) {
            Outcome::Malformed
        } else if grew(|counters| counters.wrong_source) {
            Outcome::WrongSource
        } else if grew(|counters| counters.early + counters.unsolicited) {
            Outcome::Ignored
        } else {
            Outcome::Reply
        }
    }

    /// A frame sent 0.1 ms before `now`, as the server encodes it.
    pub(crate) fn encode(&self, frame: &Frame) -> Vec<u8> {
        let capture_ns = self.now_ns - frame.age_ns;
        let transmit = self.server.ticks_at(self.now_ns - 100_000);
        let content = FrameContent {
            number: frame.number,
            rigid_bodies: &frame.bodies,
            timestamp_s: frame.timestamp_s.unwrap_or(capture_ns as f64 * 1e-9 + 77.0),
            ticks: frame.ticks.unwrap_or(CameraTicks {
                mid_exposure: if frame.has_mid_exposure {
                    self.server.ticks_at(capture_ns)
                } else {
                    0
                },
                received: transmit,
                transmit,
            }),
            flags: frame.flags,
            ..FrameContent::default()
        };
        let mut out = vec![0; 4096];
        let len = encode::frame(self.server.stream, &content, &mut out).unwrap();
        out.truncate(len);
        out
    }

    /// Delivers a frame now.
    pub(crate) fn frame(&mut self, frame: &Frame) -> Outcome {
        let bytes = self.encode(frame);
        self.receive(&bytes)
    }

    /// Lets 10 ms pass, delivers a frame and returns the state of the body in it.
    #[track_caller]
    pub(crate) fn next_state(&mut self, frame: &Frame) -> PoseState {
        self.run(10 * MS);
        match self.frame(frame) {
            Outcome::Frame(observation) => observation.state,
            other => panic!("not taken: {other:?}"),
        }
    }

    pub(crate) fn count_sent(&self, what: &Sent) -> usize {
        self.sent.iter().filter(|(_, sent)| sent == what).count()
    }
}

fn keep(event: PlanarEvent, events: &mut Vec<SessionEvent>, bindings: &mut Vec<Binding>) {
    match event {
        PlanarEvent::Session(event) => events.push(event),
        PlanarEvent::Binding(binding) => bindings.push(binding),
        PlanarEvent::Observed(_) | PlanarEvent::Other(_) => {}
    }
}

/// What became of a datagram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Outcome {
    /// The newest frame.
    Frame(Observation),
    /// A frame older than the newest, or of another sender.
    Late,
    Duplicate,
    Reply,
    Ignored,
    WrongSource,
    Malformed,
}

/// A frame to be sent.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub(crate) number: i32,
    pub(crate) bodies: Vec<RigidBody>,
    pub(crate) flags: FrameFlags,
    pub(crate) has_mid_exposure: bool,
    /// Instead of the true ones.
    pub(crate) timestamp_s: Option<f64>,
    pub(crate) ticks: Option<CameraTicks>,
    /// Time since it was captured.
    pub(crate) age_ns: u64,
}

impl Frame {
    pub(crate) fn new(number: i32, bodies: &[RigidBody]) -> Self {
        Self {
            number,
            bodies: bodies.to_vec(),
            flags: FrameFlags::default(),
            has_mid_exposure: true,
            timestamp_s: None,
            ticks: None,
            age_ns: 8 * MS,
        }
    }

    /// A frame with the car at rest in the origin.
    pub(crate) fn at_rest(number: i32) -> Self {
        Self::new(number, &[car_at(0.0, 0.0)])
    }
}

/// The car in the plane, heading along x.
pub(crate) fn car_at(x_m: f32, y_m: f32) -> RigidBody {
    RigidBody::tracked(CAR, [x_m, y_m, 0.05], [0.0, 0.0, 0.0, 1.0])
}

/// The car in the origin, with a heading.
pub(crate) fn car_heading(yaw_rad: f32) -> RigidBody {
    let (sin, cos) = (yaw_rad / 2.0).sin_cos();
    RigidBody::tracked(CAR, [0.0, 0.0, 0.05], [0.0, 0.0, sin, cos])
}

/// A small reproducible random generator for delays.
pub(crate) fn jitter(mut seed: u64) -> impl FnMut(u64) -> u64 {
    move |below_ns| {
        seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) % below_ns.max(1)
    }
}
