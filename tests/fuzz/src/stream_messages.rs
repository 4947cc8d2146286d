//! Fuzz target: what servers over streams send to the motion capture client.

use core::net::{IpAddr, Ipv4Addr, SocketAddr};

use singletrack_mocap::{
    Input, LocalEnd, Protocol, Transport, UpAxis,
    planar::{PlanarConfig, PlanarEvent, PlanarSession, PoseState},
    qualisys::packet::{ByteOrder, Component, FrameBody, Kind, Packet, write_frame},
    vrpn::message::{
        COOKIE, Message, PONG, POSE, Pose, SENDER_DESCRIPTION, TYPE_DESCRIPTION, description,
    },
};

use crate::choices::Choices;

const SERVER: IpAddr = IpAddr::V4(Ipv4Addr::new(192, 168, 1, 10));
const STRANGER: IpAddr = IpAddr::V4(Ipv4Addr::new(192, 168, 1, 66));
const MS: u64 = 1_000_000;

/// Runs a VRPN or Qualisys session on messages, damaged ones and arbitrary bytes, on the stream
/// and as datagrams, at any time.
///
/// # Panics
///
/// If an accepted pose is not finite, tilted more than is allowed, or captured after it arrived;
/// if more bytes are used than there are; if a stranger's datagram makes a pose; if the session
/// sends to another address, or without end; if it wants to be woken in the past.
///
/// Returns the number of inputs.
pub fn stream_messages(data: &[u8]) -> u64 {
    run(data).inputs
}

fn run(data: &[u8]) -> Bench {
    let mut choices = Choices::new(data);
    let order = choices.one_of([None, Some(ByteOrder::Little), Some(ByteOrder::Big)]);
    let transport = choices.one_of([Transport::Unicast { bitstream: None }, Transport::Stream]);
    let mut config = PlanarConfig::new(SERVER, transport, "car", UpAxis::Z)
        .expect("the configuration is a good one");
    config.session.protocol = match order {
        None => Protocol::Vrpn { sensor: 0 },
        Some(_) => Protocol::Qualisys,
    };
    let mut bench = Bench {
        session: PlanarSession::new(config).expect("the configuration is a good one"),
        now_ns: 1_000_000 * MS,
        received: Vec::new(),
        inputs: 0,
        poses: 0,
    };
    bench.settle();
    while !choices.is_empty() {
        bench.step(order, &mut choices);
    }
    bench
}

struct Bench {
    session: PlanarSession,
    now_ns: u64,
    /// What arrived on the stream and was not used.
    received: Vec<u8>,
    inputs: u64,
    /// Accepted ones.
    poses: u64,
}

impl Bench {
    fn step(&mut self, order: Option<ByteOrder>, choices: &mut Choices<'_>) {
        let operation = choices.byte();
        let mut bytes = match operation % 12 {
            0 => {
                self.now_ns += u64::from(choices.u16()) * MS;
                return self.settle();
            }
            1 => {
                self.received.clear();
                self.input(Input::Opened(LocalEnd {
                    address: SERVER,
                    datagram_port: choices.u16(),
                }));
                return self.settle();
            }
            2 => {
                self.received.clear();
                self.input(Input::Closed);
                return self.settle();
            }
            3 => choices.bytes().to_vec(),
            _ => message(order, operation % 12, self.now_ns / 1_000, choices),
        };
        if operation & 0x80 != 0 {
            let at = usize::from(choices.byte());
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= choices.byte();
            }
        }
        match operation >> 5 & 3 {
            0 => {
                let source = SocketAddr::new(SERVER, 1_000);
                self.input(Input::Datagram {
                    source,
                    bytes: &bytes,
                });
            }
            1 => {
                let poses = self.session.counters().session.frames;
                let source = SocketAddr::new(STRANGER, 1_000);
                self.input(Input::Datagram {
                    source,
                    bytes: &bytes,
                });
                assert_eq!(
                    self.session.counters().session.frames,
                    poses,
                    "of a stranger"
                );
            }
            _ => {
                self.received.extend_from_slice(&bytes);
                let received = core::mem::take(&mut self.received);
                let used = self.input(Input::Stream(&received));
                let rest = received
                    .get(used..)
                    .expect("more bytes used than there are");
                self.received = rest.to_vec();
            }
        }
        self.now_ns += MS;
        self.settle();
    }

    fn input(&mut self, input: Input<'_>) -> usize {
        self.inputs += 1;
        let (now_ns, poses) = (self.now_ns, &mut self.poses);
        self.session.handle_input(now_ns, input, &mut |event| {
            if let PlanarEvent::Observed(observation) = event
                && let PoseState::Valid(pose) = observation.state
            {
                *poses += 1;
                let numbers = [pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad];
                assert!(numbers.iter().all(|number| number.is_finite()), "{pose:?}");
                assert!(pose.tilt_rad <= 0.5, "{pose:?}");
                assert!(pose.capture_time_ns <= now_ns, "{pose:?}");
            }
        })
    }

    /// What the owner does after inputs.
    fn settle(&mut self) {
        self.session.handle_timeout(self.now_ns, &mut |_| {});
        let mut sent = 0;
        while let Some(transmit) = self.session.poll_transmit(self.now_ns) {
            assert_eq!(transmit.destination.ip(), SERVER);
            sent += 1;
            assert!(sent <= 8, "it sends without end");
        }
        let due_ns = self
            .session
            .poll_timeout()
            .expect("the session is not closed");
        assert!(due_ns > self.now_ns, "it wants to be woken in the past");
    }
}

/// A good message of a server.
fn message(
    order: Option<ByteOrder>,
    operation: u8,
    now_us: u64,
    choices: &mut Choices<'_>,
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let x = choices.f32();
    let Some(order) = order else {
        let name = choices.one_of(["car", "wand", POSE, PONG]);
        let (sender, kind, body) = match operation {
            4 => return COOKIE.to_vec(),
            5 | 6 => (
                i32::from(operation),
                TYPE_DESCRIPTION,
                description(name).to_vec(),
            ),
            7 | 8 => (
                i32::from(operation),
                SENDER_DESCRIPTION,
                description(name).to_vec(),
            ),
            9 => (7, 6, Vec::new()),
            _ => {
                let pose = Pose {
                    sensor: 0,
                    position_m: [f64::from(x), 1.0, 0.1],
                    orientation_xyzw: [0.0, 0.0, 0.0, 1.0],
                };
                (7, 5, pose.body().to_vec())
            }
        };
        let message = Message {
            stamp_us: now_us.wrapping_add(choices.u16().into()),
            sender,
            kind,
            body: &body,
        };
        message.write(0, &mut |part| bytes.extend_from_slice(part));
        return bytes;
    };
    let (kind, text) = match operation {
        4 => (Kind::Command, "QTM RT Interface connected\0"),
        5 => (Kind::Command, "Version set to 1.13\0"),
        6 => (
            Kind::Xml,
            "<The_6D><Body><Name>car</Name></Body></The_6D>\0",
        ),
        7 => (Kind::Error, "Parse error\0"),
        8 => (Kind::Event, "\u{3}"),
        9 => (Kind::NoMoreData, ""),
        _ => {
            let body = FrameBody {
                position_mm: [x, 1_000.0, 100.0],
                axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                residual_mm: 0.1,
            };
            let stamp_us = now_us.wrapping_add(choices.u16().into());
            let components = [Component::WithResiduals];
            let number = u32::from(choices.byte());
            write_frame(order, stamp_us, number, &[body], &components, &mut |part| {
                bytes.extend_from_slice(part);
            });
            return bytes;
        }
    };
    let body = text.as_bytes();
    Packet { kind, body }.write(order, &mut |part| bytes.extend_from_slice(part));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_courses_of_the_corpus_reach_poses() {
        for seed in crate::seeds::seeds("stream_messages") {
            if seed.name.starts_with("course") {
                assert!(run(&seed.bytes).poses > 0, "{}", seed.name);
            }
        }
    }
}
