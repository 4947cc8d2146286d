//! The diagnosis of the cameras: each cause is named, with the addresses and names that help.

use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    sync::Arc,
};

use rtrb::{Consumer, RingBuffer};
use singletrack_api::{Cameras, Status};
use singletrack_core::{
    cameras::{CameraReceiver, CameraReport, Channel, Sockets, StreamEvent},
    reasons::Why,
};
use singletrack_mocap::{
    LocalEnd, Protocol, Stream, Transport, UpAxis,
    planar::{PlanarConfig, PlanarSession},
    vrpn::message::{
        COOKIE, Message, PING, PONG, POSE, Pose, SENDER_DESCRIPTION, TYPE_DESCRIPTION, description,
    },
};
use singletrack_sim::{LossWindow, SimulationConfig, World};

/// Every word of a diagnosis, in the order of the checks.
const DIAGNOSES: [&str; 18] = [
    "starting",
    "good",
    "no-server",
    "other-address",
    "unsupported-version",
    "other-transport",
    "no-frames",
    "two-senders",
    "unreadable-names",
    "no-such-body",
    "ambiguous-body",
    "body-absent",
    "untracked",
    "up-axis",
    "rejected",
    "wrong-clock",
    "late-poses",
    "low-rate",
];

/// The age up to which a pose is good, in s.
const FRESH: f64 = 0.05;

const HOST: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 40_000);
const SERVER: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 2);

/// The message id of a frame.
const FRAME: u8 = 7;

/// What the network does with a datagram of the server: from where it comes, and what else.
type Network = fn(Vec<u8>) -> Vec<(Ipv4Addr, Vec<u8>)>;

fn good(bytes: Vec<u8>) -> Vec<(Ipv4Addr, Vec<u8>)> {
    vec![(SERVER, bytes)]
}

struct Scene {
    world: World,
    receiver: CameraReceiver,
    reports: Consumer<CameraReport>,
    network: Network,
    now_us: u64,
    waiting: Vec<(Ipv4Addr, Vec<u8>)>,
    /// With the time in ms.
    found: Vec<(u64, Cameras)>,
    /// The other bodies near the car, in their order.
    near: Vec<Option<String>>,
}

struct Sink<'a> {
    world: &'a mut World,
    waiting: &'a mut Vec<(Ipv4Addr, Vec<u8>)>,
}

impl Sockets for Sink<'_> {
    fn receive(&mut self, channel: Channel, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
        if channel == Channel::Data || self.waiting.is_empty() {
            return None;
        }
        let (source, bytes) = self.waiting.remove(0);
        buffer[..bytes.len()].copy_from_slice(&bytes);
        Some((bytes.len(), SocketAddr::new(source.into(), 1_510)))
    }

    fn send(&mut self, _: SocketAddr, bytes: &[u8]) {
        self.world.handle_datagram(HOST, bytes);
    }
}

impl Scene {
    /// The simulated cameras, which stream Y up, and a client that looks for `name`.
    fn new(name: &str, up_axis: UpAxis, network: Network) -> Self {
        Self::of(SimulationConfig::default(), name, up_axis, network)
    }

    fn of(mut simulation: SimulationConfig, name: &str, up_axis: UpAxis, network: Network) -> Self {
        let (observations, _) = RingBuffer::new(16);
        let (reports_in, reports) = RingBuffer::new(1_024);
        let transport = Transport::Unicast { bitstream: None };
        let config = PlanarConfig::new(SERVER.into(), transport, name, up_axis).unwrap();
        simulation.car.start.yaw_rad = 1.0;
        Self {
            world: World::new(simulation).unwrap(),
            receiver: CameraReceiver::new(
                PlanarSession::new(config).unwrap(),
                Arc::default(),
                observations,
                reports_in,
                None,
                FRESH,
            ),
            reports,
            network,
            now_us: 0,
            waiting: Vec::new(),
            found: Vec::new(),
            near: Vec::new(),
        }
    }

    fn run(&mut self, ms: u64) -> &mut Self {
        for _ in 0..2 * ms {
            self.now_us += 500;
            self.world.advance_to(self.now_us);
            while let Some(datagram) = self.world.poll_datagram() {
                self.waiting.extend((self.network)(datagram.bytes.to_vec()));
            }
            let clock = || self.now_us * 1_000;
            let mut sink = Sink {
                world: &mut self.world,
                waiting: &mut self.waiting,
            };
            self.receiver.poll(&clock, &mut sink, &mut |_| {});
            while let Ok(report) = self.reports.pop() {
                match report {
                    CameraReport::Diagnosis(found) => {
                        self.found.push((self.now_us / 1_000, found));
                    }
                    CameraReport::Neighbour(near) => self.near.push(near),
                    CameraReport::Observation(_) | CameraReport::Counters(_) => {}
                }
            }
        }
        self
    }

    /// The words in order.
    fn words(&self) -> Vec<&str> {
        self.found
            .iter()
            .map(|(_, found)| &*found.diagnosis)
            .collect()
    }

    fn last(&self) -> &Cameras {
        &self.found.last().unwrap().1
    }
}

#[track_caller]
fn assert_text(diagnosis: &Cameras, word: &str, parts: &[&str]) {
    assert_eq!(diagnosis.diagnosis, word, "{diagnosis}");
    for part in parts {
        assert!(diagnosis.text.contains(part), "{part}: {diagnosis}");
    }
    assert_eq!(diagnosis.is_trouble(), word != "good");
    assert!(DIAGNOSES.contains(&word));
}

#[test]
fn poses_that_arrive_are_no_trouble() {
    let mut scene = Scene::new("car", UpAxis::Y, good);
    scene.run(5_000);
    assert_text(scene.last(), "good", &[]);
    assert!(!scene.words().contains(&"no-server"), "{:?}", scene.words());
    assert!(scene.found.last().unwrap().0 < 1_000);
}

#[test]
fn a_server_from_which_nothing_comes_is_named_after_three_seconds() {
    let mut scene = Scene::new("car", UpAxis::Y, |_| vec![]);
    scene.run(2_900);
    assert_eq!(scene.words(), [""; 0]);
    scene.run(500);
    assert_text(scene.last(), "no-server", &["10.0.0.2", "UDP port 1510"]);
    // Once, for as long as it lasts.
    scene.run(5_000);
    assert_eq!(scene.words(), ["no-server"]);
    scene.network = good;
    scene.run(2_000);
    assert_text(scene.last(), "good", &[]);
}

#[test]
fn packets_from_another_address_name_it_and_the_second_network_card() {
    let mut scene = Scene::new("car", UpAxis::Y, |bytes| {
        vec![(Ipv4Addr::new(10, 0, 0, 7), bytes)]
    });
    scene.run(2_500);
    assert_text(
        scene.last(),
        "other-address",
        &["10.0.0.7", "10.0.0.2", "second network card"],
    );
}

#[test]
fn a_server_that_answers_and_sends_no_frames_is_told_to_stream() {
    let mut scene = Scene::new("car", UpAxis::Y, |bytes| {
        if bytes[0] == FRAME {
            vec![]
        } else {
            good(bytes)
        }
    });
    scene.run(6_000);
    assert!(scene.words().contains(&"no-frames"), "{:?}", scene.words());
}

#[test]
fn a_missing_body_names_those_that_are_there() {
    let mut scene = Scene::new("truck", UpAxis::Y, good);
    scene.run(3_000);
    assert_text(scene.last(), "no-such-body", &["\"truck\"", "\"car\""]);
}

#[test]
fn a_wrong_up_axis_is_named_with_height_and_tilt_of_both() {
    let mut scene = Scene::new("car", UpAxis::Z, good);
    scene.run(3_000);
    assert_text(
        scene.last(),
        "up-axis",
        &["up_axis = \"z\"", "with \"y\"", "probably \"y\""],
    );
}

#[test]
fn two_senders_with_one_address_are_named_at_once() {
    let mut scene = Scene::new("car", UpAxis::Y, good);
    scene.run(3_000);
    scene.network = |bytes| {
        let mut other = bytes.clone();
        if bytes[0] == FRAME {
            // A digit of the first coordinate, or of a name: any other content.
            let middle = other.len() / 2;
            other[middle] ^= 1;
        }
        vec![(SERVER, bytes), (SERVER, other)]
    };
    let from_ms = scene.now_us / 1_000;
    scene.run(1_000);
    let (at_ms, found) = scene.found.last().unwrap();
    assert_text(found, "two-senders", &["10.0.0.2", "network of their own"]);
    assert!(at_ms - from_ms <= 400, "{}", at_ms - from_ms);
    scene.network = good;
    scene.run(3_000);
    assert_text(scene.last(), "good", &[]);
}

#[test]
fn every_word_of_a_diagnosis_is_in_the_documentation() {
    let page = include_str!("../../../docs/troubleshooting.md");
    let (_, table) = page
        .split_once("| `cameras.diagnosis` | ")
        .expect("the table");
    let documented: Vec<&str> = table
        .lines()
        .skip(2)
        .map_while(|line| line.strip_prefix("| `"))
        .filter_map(|line| line.split('`').next())
        .collect();
    assert_eq!(documented, DIAGNOSES);
}

#[test]
fn rejections_for_alternating_reasons_are_reported_and_not_at_every_change() {
    let mut scene = Scene::new("car", UpAxis::Y, good);
    scene.run(2_000);
    assert_text(scene.last(), "good", &[]);
    let before = scene.found.len();
    for step in 0..600 {
        let faults = &mut scene.world.cameras.faults;
        // No reason lasts for the patience of a second.
        faults.not_a_number = step / 25 % 2 == 0;
        // To and fro, so that no place becomes plausible.
        faults.jump_m = [if step % 2 == 0 { 300.0 } else { -300.0 }, 0.0, 0.0];
        scene.run(10);
        // A second until no good pose is among the last, and the patience.
        if step == 250 {
            assert_text(scene.last(), "rejected", &["rejected: "]);
        }
    }
    let reported = &scene.words()[before..];
    assert!(
        reported.iter().all(|word| *word == "rejected"),
        "{reported:?}"
    );
    let texts: Vec<&str> = scene.found[before..]
        .iter()
        .map(|(_, found)| found.text.as_str())
        .collect();
    assert!(texts.len() <= 6, "{texts:?}");
    for reason in ["not-finite", "jump"] {
        let named = |text: &&str| text.contains(reason);
        assert!(texts.iter().any(named), "{reason}: {texts:?}");
    }
}

#[test]
fn a_short_gap_is_not_reported() {
    let mut scene = Scene::new("car", UpAxis::Y, good);
    scene.run(2_000);
    let before = scene.found.len();
    scene.network = |_| vec![];
    scene.run(1_500);
    scene.network = good;
    scene.run(1_000);
    assert_eq!(scene.found.len(), before);
}

#[test]
fn a_server_that_falls_silent_is_not_good_after_two_seconds() {
    let mut scene = Scene::new("car", UpAxis::Y, good);
    scene.run(2_000);
    scene.network = |_| vec![];
    scene.run(2_300);
    assert_text(scene.last(), "no-server", &["10.0.0.2"]);
    // One that answers and sends no frames any more.
    scene.network = good;
    scene.run(2_000);
    assert_text(scene.last(), "good", &[]);
    scene.network = |bytes| {
        if bytes[0] == FRAME {
            vec![]
        } else {
            good(bytes)
        }
    };
    scene.run(2_300);
    assert_eq!(scene.words().last(), Some(&"no-frames"));
}

/// Cameras with this rate (Hz) and latency (ms).
fn cameras(rate: u64, latency_ms: u64) -> Scene {
    let mut simulation = SimulationConfig::default();
    simulation.cameras.period_us = 1_000_000 / rate;
    simulation.cameras.latency_us = 1_000 * latency_ms;
    let mut scene = Scene::of(simulation, "car", UpAxis::Y, good);
    scene.run(4_000);
    scene
}

#[test]
fn a_frame_rate_or_a_latency_with_which_no_car_is_armed_is_named() {
    for (rate, latency_ms) in [(100, 8), (100, 35), (60, 25), (30, 8)] {
        assert_text(cameras(rate, latency_ms).last(), "good", &[]);
    }
    for rate in [10, 20] {
        let hz = format!("{rate} Hz");
        assert_text(cameras(rate, 8).last(), "low-rate", &[&hz, "frame rate"]);
    }
    for (rate, latency_ms) in [(100, 60), (60, 45)] {
        let age = format!("{latency_ms} ms old");
        assert_text(
            cameras(rate, latency_ms).last(),
            "late-poses",
            &[&age, "latency"],
        );
    }
}

#[test]
fn definitions_that_can_t_be_read_are_named_with_the_error() {
    /// The message id of the definitions.
    const DEFINITIONS: u8 = 5;
    let mut scene = Scene::new("car", UpAxis::Y, |mut bytes| {
        if bytes[0] == DEFINITIONS {
            // The number of bodies.
            bytes[7] = 1;
        }
        good(bytes)
    });
    scene.run(4_000);
    assert_text(
        scene.last(),
        "unreadable-names",
        &["dataset count at byte 4"],
    );
}

/// A body at this place beside the car, which stands at the origin.
fn beside(x_m: f64) -> SimulationConfig {
    let mut simulation = SimulationConfig::default();
    let carrier = simulation.cameras.decoys.last_mut().unwrap();
    carrier.position_m = [x_m, 0.0, 0.1];
    simulation
}

#[test]
fn another_body_beside_a_car_that_is_lost_is_named() {
    let mut simulation = beside(0.4);
    simulation.cameras.loss_windows = vec![LossWindow {
        start_us: 2_000_000,
        end_us: 10_000_000,
    }];
    let mut scene = Scene::of(simulation, "car", UpAxis::Y, good);
    scene.run(2_000);
    assert_text(scene.last(), "good", &[]);
    scene.run(3_000);
    assert_text(scene.last(), "untracked", &[]);
    let text = scene.last().to_string();
    for part in ["\"carrier\"", "(streaming id 17)", "0.5 m of \"car\""] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert_eq!(scene.near.len(), 1, "{:?}", scene.near);
}

#[test]
fn a_body_whose_place_the_stream_gives_to_the_car_is_named_at_once() {
    let mut simulation = SimulationConfig::default();
    // 3.7 m away.
    simulation.cameras.other_body_from_s = Some(2.0);
    let mut scene = Scene::of(simulation, "car", UpAxis::Y, good);
    scene.run(1_990);
    assert_eq!(scene.near, []);
    scene.run(60);
    let near = scene.near.last().and_then(Option::as_ref).unwrap();
    assert!(near.contains("\"wand\" (streaming id 3)"), "{near}");
}

#[test]
fn a_body_that_is_not_near_is_not_named() {
    let mut scene = Scene::of(beside(0.6), "car", UpAxis::Y, good);
    scene.run(3_000);
    assert_eq!(scene.near, []);
    assert_eq!(scene.last().neighbour, None);
}

const VRPN_SERVER: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 2));
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
    let mut config = PlanarConfig::new(VRPN_SERVER, Transport::Stream, "car", UpAxis::Z).unwrap();
    config.session.protocol = Protocol::Vrpn { sensor: 0 };
    config.session.command_port = config.session.protocol.default_port();
    let session = PlanarSession::new(config).unwrap();
    let mut receiver = CameraReceiver::new(
        session,
        Arc::default(),
        observations,
        reports_in,
        None,
        FRESH,
    );
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
                found = (diagnosis.diagnosis.into_owned(), diagnosis.text);
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

/// What a person reads of a status with this state, and this at its top.
fn why(mode: &str, reason: &str, top: &str) -> String {
    let text = format!(
        "figures = {{}}\nrealtime = {{}}\n{top}\n\
         [state]\ntopic = \"state\"\ntick = 1\nt_s = 0.0\ntime_ns = 1\nx_m = 1.234\ny_m = -0.5\n\
         mode = \"{mode}\"\nreason = \"{reason}\"\nlink = \"ready\"\nheld = true\n\
         steering_rad = 0.0\ncommanded_speed_m_s = 0.0\nfiltering = \"none\"\nfiltered_ticks = 0\n\
         [cameras]\ndiagnosis = \"no-server\"\ntext = \"nothing comes: is the port open?\"\n\
         [configuration]\nnumber = 1\n"
    );
    let status: Status = toml::from_str(&text).unwrap();
    Why::of(&status).unwrap().to_string()
}

#[test]
fn a_status_says_why_the_port_does_not_open_and_where_the_car_is() {
    let port = "serial_error = \"/dev/x: no such device; plug the board in\"";
    let told = why("disconnected", "link-down", port);
    assert!(
        told.ends_with("To do: /dev/x: no such device; plug the board in."),
        "{told}"
    );
    let told = why("disconnected", "link-down", "");
    assert!(told.contains("To do: Plug the board in"), "{told}");
    // It answers again.
    let told = why("ready", "link-down", "");
    assert!(
        told.starts_with("the last drive ended") && !told.contains("To do"),
        "{told}"
    );
    let told = why("stopping", "outside-fence", "");
    assert!(told.contains("at (1.23, -0.50) m"), "{told}");
    let told = why("idle", "no-pose", "");
    assert!(told.ends_with("is the port open?"), "{told}");
}
