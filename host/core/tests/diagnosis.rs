//! The diagnosis of the cameras: each cause is named, with the addresses and names that help.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;

use rtrb::{Consumer, RingBuffer};
use singletrack_core::{
    cameras::{CameraReceiver, CameraReport, Channel, Sockets},
    diagnosis::{DIAGNOSES, Diagnosis},
};
use singletrack_mocap::{
    Transport, UpAxis,
    planar::{PlanarConfig, PlanarSession},
};
use singletrack_sim::{LossWindow, SimulationConfig, World};

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
    found: Vec<(u64, Diagnosis)>,
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
        self.found.iter().map(|(_, found)| found.word).collect()
    }

    fn last(&self) -> &Diagnosis {
        &self.found.last().unwrap().1
    }
}

#[track_caller]
fn assert_text(diagnosis: &Diagnosis, word: &str, parts: &[&str]) {
    assert_eq!(diagnosis.word, word, "{diagnosis}");
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
        let faults = scene.world.cameras_mut().faults_mut();
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
