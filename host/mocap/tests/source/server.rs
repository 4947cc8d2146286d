//! Scripted servers of all kinds.

use std::num::NonZeroU64;

use singletrack_mocap::{
    codec::{
        BitstreamVersion, CameraTicks, ClientMessage, Connection, DataChannel, Echo, FrameFlags,
        RigidBody, RigidBodyDefinition, ServerInfo,
    },
    encode::{self, Dataset, EncodeError, FrameContent},
    qualisys::packet::{ByteOrder, Component, FrameBody, Kind as PacketKind, Packet, write_frame},
    vrpn::message::{
        COOKIE, Message, PING, PONG, POSE, Pose, SENDER_DESCRIPTION, TYPE_DESCRIPTION,
        UDP_DESCRIPTION, description,
    },
};

/// What a server speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    NatNet,
    Vrpn,
    Qualisys(ByteOrder),
}

pub(crate) const KINDS: [Kind; 4] = [
    Kind::NatNet,
    Kind::Vrpn,
    Kind::Qualisys(ByteOrder::Little),
    Kind::Qualisys(ByteOrder::Big),
];

/// Those with a stream.
pub(crate) const STREAMS: [Kind; 3] = [KINDS[1], KINDS[2], KINDS[3]];

/// What the server sends.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sent {
    pub(crate) stream: Vec<u8>,
    pub(crate) datagrams: Vec<Vec<u8>>,
}

/// A server whose clock is `now_us + offset_us`.
#[derive(Clone, Debug)]
pub(crate) struct Server {
    pub(crate) kind: Kind,
    pub(crate) offset_us: u64,
    /// Its bodies, in order: the name, and the position of the first one's pivot from x.
    pub(crate) bodies: Vec<&'static str>,
    /// Added to the numbers of bodies and types.
    pub(crate) numbers: i32,
    /// Bodies that are not seen.
    pub(crate) unseen: Vec<&'static str>,
    /// VRPN: zeros instead of silence for them.
    pub(crate) zeros: bool,
    /// VRPN: pings that are not answered.
    pub(crate) ignored_pings: u32,
    /// Qualisys: the list has a body more than the frames.
    pub(crate) lists_more: bool,
    /// Questions for the names.
    pub(crate) questions: u32,
    models_changed: bool,
    frame: i32,
    input: Vec<u8>,
    welcomed: bool,
    streams: bool,
    over_udp: bool,
    client_ping: Option<i32>,
    sequence: u32,
}

const VERSION: BitstreamVersion = BitstreamVersion::V4_1;

impl Server {
    pub(crate) fn new(kind: Kind) -> Self {
        Self {
            kind,
            offset_us: 1_700_000_000_000_000,
            bodies: vec!["wand", "car"],
            numbers: 3,
            unseen: Vec::new(),
            zeros: false,
            ignored_pings: 0,
            lists_more: false,
            questions: 0,
            models_changed: false,
            frame: 0,
            input: Vec::new(),
            welcomed: false,
            streams: false,
            over_udp: false,
            client_ping: None,
            sequence: 0,
        }
    }

    /// A client has connected; returns what it is told first.
    pub(crate) fn connected(&mut self) -> Sent {
        let mut sent = Sent::default();
        (self.welcomed, self.streams, self.over_udp) = (false, false, false);
        (self.client_ping, self.input) = (None, Vec::new());
        if let Kind::Qualisys(order) = self.kind {
            say(
                order,
                PacketKind::Command,
                "QTM RT Interface connected",
                &mut sent,
            );
        }
        sent
    }

    /// The bodies have other numbers or places from now on, and the client is told.
    pub(crate) fn renumber(&mut self) -> Sent {
        let mut sent = Sent::default();
        self.numbers += 7;
        self.models_changed = true;
        match self.kind {
            Kind::Vrpn => self.describe(0, &mut sent),
            // A place in the list changes with the number of bodies.
            Kind::Qualisys(_) => self.bodies.insert(0, "new"),
            Kind::NatNet => {}
        }
        sent
    }

    fn vrpn(&mut self, stamp_us: u64, sender: i32, kind: i32, body: &[u8], to: &mut Vec<u8>) {
        let message = Message {
            stamp_us,
            sender,
            kind,
            body,
        };
        message.write(self.sequence, &mut |part| to.extend_from_slice(part));
        self.sequence += 1;
    }

    fn describe(&mut self, stamp_us: u64, sent: &mut Sent) {
        let n = self.numbers;
        for (number, name) in [
            (n, POSE),
            (n + 1, PING),
            (n + 2, PONG),
            (n + 3, "vrpn_Text"),
        ] {
            self.vrpn(
                stamp_us,
                number,
                TYPE_DESCRIPTION,
                &description(name),
                &mut sent.stream,
            );
        }
        self.vrpn(
            stamp_us,
            0,
            SENDER_DESCRIPTION,
            &description("VRPN Control"),
            &mut sent.stream,
        );
        for (number, name) in (n..).zip(self.bodies.clone()) {
            self.vrpn(
                stamp_us,
                number,
                SENDER_DESCRIPTION,
                &description(name),
                &mut sent.stream,
            );
        }
    }

    /// Something else than poses: texts, buttons, events.
    pub(crate) fn chatter(&mut self, now_us: u64) -> Sent {
        let mut sent = Sent::default();
        match self.kind {
            Kind::Vrpn => {
                let n = self.numbers;
                let text = vec![65; 300];
                self.vrpn(now_us + self.offset_us, n, n + 3, &text, &mut sent.stream);
                self.vrpn(now_us + self.offset_us, n, 99, &[1, 2, 3], &mut sent.stream);
                self.vrpn(now_us + self.offset_us, n, n + 1, &[], &mut sent.stream);
            }
            Kind::Qualisys(order) => {
                for (kind, text) in [(PacketKind::Event, "\u{3}"), (PacketKind::Command, "Hello")] {
                    say(order, kind, text, &mut sent);
                }
            }
            Kind::NatNet => sent.datagrams.extend(encoded(encode::unrecognized)),
        }
        sent
    }

    /// What the client sent on the stream, or as a datagram.
    pub(crate) fn receive(&mut self, now_us: u64, bytes: &[u8]) -> Sent {
        let mut sent = Sent::default();
        match self.kind {
            Kind::NatNet => self.natnet(now_us, bytes, &mut sent),
            Kind::Vrpn => {
                self.input.extend_from_slice(bytes);
                self.vrpn_input(now_us, &mut sent);
            }
            Kind::Qualisys(order) => {
                self.input.extend_from_slice(bytes);
                let input = std::mem::take(&mut self.input);
                let mut rest = &input[..];
                while let Some((packet, length)) = Packet::read(order, rest).unwrap() {
                    let command = packet.text().unwrap().to_owned();
                    self.command(order, &command, &mut sent);
                    rest = &rest[length..];
                }
                self.input = rest.to_vec();
            }
        }
        sent
    }

    fn vrpn_input(&mut self, now_us: u64, sent: &mut Sent) {
        let stamp_us = now_us + self.offset_us;
        if !self.welcomed {
            if self.input.len() < 24 {
                return;
            }
            assert_eq!(self.input[..24], COOKIE);
            self.input.drain(..24);
            (self.welcomed, self.streams) = (true, true);
            sent.stream.extend(COOKIE);
            self.describe(stamp_us, sent);
        }
        let input = std::mem::take(&mut self.input);
        let mut rest = &input[..];
        while let Some((message, length)) = Message::read(rest).unwrap() {
            match message.kind {
                UDP_DESCRIPTION => self.over_udp = true,
                TYPE_DESCRIPTION if message.described() == Some(PING.as_bytes()) => {
                    self.client_ping = Some(message.sender);
                }
                kind if Some(kind) == self.client_ping && self.ignored_pings > 0 => {
                    self.ignored_pings -= 1;
                }
                kind if Some(kind) == self.client_ping => {
                    let n = self.numbers;
                    self.vrpn(stamp_us, n, n + 2, &[], &mut sent.stream);
                }
                _ => {}
            }
            rest = &rest[length..];
        }
        self.input = rest.to_vec();
    }

    fn command(&mut self, order: ByteOrder, command: &str, sent: &mut Sent) {
        if command.starts_with("Version") {
            say(order, PacketKind::Command, "Version set to 1.13", sent);
        } else if command == "GetParameters 6D" {
            let bodies = self.bodies.iter();
            let named = bodies.map(|name| format!("<Body>\n<Name>{name}</Name><Point/></Body>"));
            let mut list: String = named.collect();
            self.questions += 1;
            if self.lists_more {
                list += "<Body><Name>more</Name></Body>";
            }
            let xml = format!("<QTM_Parameters_Ver_1.13><The_6D>{list}</The_6D></QTM>");
            say(order, PacketKind::Xml, &xml, sent);
        } else if command.starts_with("StreamFrames AllFrames") {
            (self.streams, self.over_udp) = (true, command.contains("UDP:"));
        } else {
            panic!("not a command: {command}");
        }
    }

    fn natnet(&mut self, now_us: u64, bytes: &[u8], sent: &mut Sent) {
        let answer = match ClientMessage::decode(bytes).unwrap() {
            ClientMessage::Connect(_) => {
                (self.streams, self.over_udp) = (true, true);
                let info = ServerInfo {
                    application: "scripted",
                    application_version: [1, 0, 0, 0],
                    natnet_version: VERSION.to_wire(),
                    connection: Some(Connection {
                        ticks_per_second: NonZeroU64::new(1_000_000),
                        data_channel: DataChannel {
                            port: 1511,
                            multicast: false,
                            group: std::net::Ipv4Addr::new(239, 255, 42, 99),
                        },
                    }),
                };
                encoded(|out| encode::server_info(&info, out))
            }
            ClientMessage::EchoRequest { client_stamp } => {
                let echo = Echo {
                    client_stamp,
                    server_ticks: now_us + self.offset_us,
                };
                encoded(|out| encode::echo_response(echo, out))
            }
            ClientMessage::RequestModelDefinitions => {
                let bodies: Vec<_> = (self.numbers..)
                    .zip(&self.bodies)
                    .map(|(id, name)| {
                        Dataset::RigidBody(RigidBodyDefinition {
                            name: name.as_bytes(),
                            id,
                            parent_id: -1,
                            offset_m: [0.0; 3],
                        })
                    })
                    .collect();
                encoded(|out| encode::model_definitions(VERSION, &bodies, out))
            }
            _ => None,
        };
        sent.datagrams.extend(answer);
    }

    /// The frame of an exposure at `exposed_us`: each body is at (x, its place in the list + 1).
    pub(crate) fn frame(&mut self, exposed_us: u64, x_m: f64) -> Sent {
        let mut sent = Sent::default();
        if !self.streams {
            return sent;
        }
        self.frame += 1;
        let stamp_us = exposed_us + self.offset_us;
        let mut bytes = Vec::new();
        let bodies = self.bodies.clone();
        let of_body = |name: &str| [x_m, place(name), 0.1];
        match self.kind {
            Kind::NatNet => {
                let rigid_bodies: Vec<_> = (self.numbers..)
                    .zip(&bodies)
                    .map(|(id, name)| {
                        let position = of_body(name).map(|x| x as f32);
                        RigidBody::tracked(id, position, [0.0, 0.0, 0.0, 1.0])
                            .with_tracking_valid(!self.unseen.contains(name))
                    })
                    .collect();
                let content = FrameContent {
                    number: self.frame,
                    rigid_bodies: &rigid_bodies,
                    timestamp_s: stamp_us as f64 * 1e-6,
                    ticks: CameraTicks {
                        mid_exposure: stamp_us,
                        received: stamp_us + 1_000,
                        transmit: stamp_us + 1_000,
                    },
                    flags: match std::mem::take(&mut self.models_changed) {
                        true => FrameFlags::MODELS_CHANGED,
                        false => FrameFlags::default(),
                    },
                    ..FrameContent::default()
                };
                bytes.extend(encoded(|out| encode::frame(VERSION, &content, out)).unwrap());
            }
            Kind::Vrpn => {
                let n = self.numbers;
                for (number, name) in (n..).zip(bodies) {
                    let is_unseen = self.unseen.contains(&name);
                    if is_unseen && !self.zeros {
                        continue;
                    }
                    let pose = Pose {
                        sensor: 0,
                        position_m: if is_unseen { [0.0; 3] } else { of_body(name) },
                        orientation_xyzw: [0.0, 0.0, 0.0, if is_unseen { 0.0 } else { 1.0 }],
                    };
                    self.vrpn(stamp_us, number, n, &pose.body(), &mut bytes);
                }
            }
            Kind::Qualisys(order) => {
                let bodies: Vec<_> = bodies
                    .iter()
                    .map(|name| match self.unseen.contains(name) {
                        true => FrameBody {
                            position_mm: [f32::NAN; 3],
                            axes: [[f32::NAN; 3]; 3],
                            residual_mm: f32::NAN,
                        },
                        false => FrameBody {
                            position_mm: of_body(name).map(|metres| (metres * 1e3) as f32),
                            axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                            residual_mm: 0.3,
                        },
                    })
                    .collect();
                let components = [Component::EulerAngles, Component::WithResiduals];
                let number = self.frame.unsigned_abs();
                write_frame(order, stamp_us, number, &bodies, &components, &mut |part| {
                    bytes.extend_from_slice(part);
                });
            }
        }
        if self.over_udp {
            sent.datagrams.push(bytes);
        } else {
            sent.stream = bytes;
        }
        sent
    }
}

/// Where a body is, by its name: its y in metres.
pub(crate) fn place(name: &str) -> f64 {
    match name {
        "car" => 2.0,
        "wand" => 1.0,
        _ => 3.0,
    }
}

fn say(order: ByteOrder, kind: PacketKind, text: &str, sent: &mut Sent) {
    let body = [text.as_bytes(), &[0]].concat();
    let packet = Packet { kind, body: &body };
    packet.write(order, &mut |part| sent.stream.extend_from_slice(part));
}

fn encoded(encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>) -> Option<Vec<u8>> {
    let mut out = vec![0; 4_096];
    let length = encode(&mut out).unwrap();
    out.truncate(length);
    Some(out)
}
