//! The diagnosis of a VRPN server whose stamps are wrong, while it shows its clock when it is asked.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;

use rtrb::RingBuffer;
use singletrack_core::cameras::{CameraReceiver, CameraReport, Channel, Sockets, StreamEvent};
use singletrack_mocap::{
    LocalEnd, Protocol, Stream, Transport, UpAxis,
    planar::{PlanarConfig, PlanarSession},
    vrpn::message::{
        COOKIE, Message, PING, PONG, POSE, Pose, SENDER_DESCRIPTION, TYPE_DESCRIPTION, description,
    },
};

const SERVER: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 2));
/// The server's clock at the beginning, and the client's.
const SERVER_US: u64 = 1_700_000_000_000_000;
const CLIENT_US: u64 = 100_000_000_000;

/// A server with one tracker, the car.
#[derive(Default)]
struct Server {
    now_us: u64,
    stream: Option<Stream>,
    input: Vec<u8>,
    output: Vec<u8>,
    welcomed: bool,
    ping: Option<i32>,
}

impl Server {
    fn say(&mut self, stamp_us: u64, kind: i32, body: &[u8]) {
        let message = Message {
            stamp_us,
            sender: 1,
            kind,
            body,
        };
        message.write(0, &mut |part| self.output.extend_from_slice(part));
    }

    fn describe(&mut self) {
        for (number, name) in [(1, POSE), (2, PING), (3, PONG)] {
            let message = Message {
                stamp_us: 0,
                sender: number,
                kind: TYPE_DESCRIPTION,
                body: &description(name),
            };
            message.write(0, &mut |part| self.output.extend_from_slice(part));
        }
        self.say(0, SENDER_DESCRIPTION, &description("car"));
    }

    fn pose(&mut self, stamp_us: u64) {
        let pose = Pose {
            sensor: 0,
            // No two are equal to the bit.
            position_m: [1.0 + 1e-9 * self.now_us as f64, 2.0, 0.1],
            orientation_xyzw: [0.0, 0.0, 0.0, 1.0],
        };
        if self.welcomed {
            self.say(stamp_us, 1, &pose.body());
        }
    }
}

impl Sockets for Server {
    fn receive(&mut self, _: Channel, _: &mut [u8]) -> Option<(usize, SocketAddr)> {
        None
    }

    fn send(&mut self, _: SocketAddr, _: &[u8]) {}

    fn stream(&mut self, wanted: Option<Stream>, received: &mut Vec<u8>) -> StreamEvent {
        if wanted != self.stream {
            *self = Self {
                now_us: self.now_us,
                stream: wanted,
                ..Self::default()
            };
            return match wanted {
                Some(_) => StreamEvent::Opened(LocalEnd {
                    address: Ipv4Addr::LOCALHOST.into(),
                    datagram_port: 5_000,
                }),
                None => StreamEvent::Nothing,
            };
        }
        if self.output.is_empty() {
            return StreamEvent::Nothing;
        }
        received.append(&mut self.output);
        StreamEvent::Received
    }

    fn write_stream(&mut self, bytes: &[u8]) {
        self.input.extend_from_slice(bytes);
        let input = std::mem::take(&mut self.input);
        let mut rest = &input[..];
        if !self.welcomed && rest.len() >= COOKIE.len() {
            self.welcomed = true;
            rest = &rest[COOKIE.len()..];
            self.output.extend(COOKIE);
            self.describe();
        }
        while self.welcomed
            && let Some((message, length)) = Message::read(rest).unwrap()
        {
            if message.kind == TYPE_DESCRIPTION && message.described() == Some(PING.as_bytes()) {
                self.ping = Some(message.sender);
            } else if Some(message.kind) == self.ping {
                self.say(SERVER_US + self.now_us, 3, &[]);
            }
            rest = &rest[length..];
        }
        self.input = rest.to_vec();
    }
}

/// The last diagnosis of ten seconds of poses at 100 Hz, 5 ms after their exposure, whose stamps are
/// these of the clock's time: the word and the text.
fn diagnosed(stamp_us: impl Fn(u64) -> u64) -> (String, String) {
    let (observations, _keep) = RingBuffer::new(16);
    let (reports_in, mut reports) = RingBuffer::new(1_024);
    let mut config = PlanarConfig::new(SERVER, Transport::Stream, "car", UpAxis::Z).unwrap();
    config.session.protocol = Protocol::Vrpn { sensor: 0 };
    config.session.command_port = config.session.protocol.default_port();
    let session = PlanarSession::new(config).unwrap();
    let mut receiver = CameraReceiver::new(session, Arc::default(), observations, reports_in);
    let mut server = Server::default();
    let mut found = (String::new(), String::new());
    for ms in 0..10_000 {
        server.now_us = 1_000 * ms;
        if ms % 10 == 5 {
            server.pose(stamp_us(SERVER_US + server.now_us - 5_000));
        }
        let clock = || 1_000 * (CLIENT_US + 1_000 * ms);
        receiver.poll(&clock, &mut server, &mut |_| {});
        while let Ok(report) = reports.pop() {
            if let CameraReport::Diagnosis(diagnosis) = report {
                found = (diagnosis.word.to_owned(), diagnosis.text);
            }
        }
    }
    found
}

#[test]
fn stamps_by_the_servers_clock_are_good() {
    assert_eq!(diagnosed(|now_us| now_us).0, "good");
}

#[test]
fn stamps_that_do_not_advance_are_a_wrong_clock_and_not_missing_markers() {
    let stamps: [fn(u64) -> u64; 3] = [
        |_| SERVER_US,
        |_| 0,
        |now_us| now_us / 1_000_000 * 1_000_000,
    ];
    for stamp_us in stamps {
        let (word, text) = diagnosed(stamp_us);
        assert_eq!(word, "wrong-clock", "{text}");
        assert!(
            text.contains("10.0.0.2") && text.contains("stamp"),
            "{text}"
        );
    }
}

#[test]
fn stamps_of_another_time_zone_are_a_wrong_clock() {
    const MINUTE_US: u64 = 60_000_000;
    let (word, text) = diagnosed(|now_us| now_us - 30 * MINUTE_US);
    assert_eq!(word, "wrong-clock", "{text}");
    assert!(text.contains("1800 s before they arrive"), "{text}");
    for minutes in [-120, 120] {
        let off_us = minutes * MINUTE_US.cast_signed();
        let (word, text) = diagnosed(|now_us| now_us.saturating_add_signed(off_us));
        assert_eq!(word, "wrong-clock", "{minutes}: {text}");
        assert!(text.contains("UTC"), "{text}");
    }
}

#[test]
fn stamps_that_go_back_by_a_day_are_a_wrong_clock() {
    const DAY_US: u64 = 86_400_000_000;
    let (word, text) = diagnosed(|now_us| match now_us - SERVER_US {
        ..5_000_000 => now_us,
        _ => now_us - DAY_US,
    });
    assert_eq!(word, "wrong-clock", "{text}");
    assert!(text.contains("UTC"), "{text}");
}
