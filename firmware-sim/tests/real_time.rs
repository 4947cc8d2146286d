//! The real-time simulator through its pseudo-terminal and UDP.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::{
    fs::{File, OpenOptions},
    io::{Read, Write},
    net::{Ipv4Addr, UdpSocket},
    os::unix::fs::OpenOptionsExt,
    path::Path,
    time::{Duration, Instant},
};

use singletrack_mocap::{
    codec::{BitstreamVersion, ClientMessage, Connect, ServerMessage},
    encode,
};
use singletrack_sim::{
    Pty, RealTimeConfig, RealTimeSimulator, ScriptedHost, SimulationConfig, UdpConfig,
};

/// `O_NONBLOCK` and `O_NOCTTY` on Linux.
const NON_BLOCKING: i32 = 0o4000 | 0o400;
const TIMEOUT: Duration = Duration::from_secs(5);

fn open(path: &Path) -> File {
    OpenOptions::new()
        .read(true)
        .write(true)
        .custom_flags(NON_BLOCKING)
        .open(path)
        .unwrap()
}

/// Polls until `done` returns true.
fn wait_for(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < TIMEOUT, "no {what} in {TIMEOUT:?}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn every_byte_value_passes_the_pseudo_terminal_unchanged_both_ways() {
    let pty = Pty::open(None).unwrap();
    let mut host = open(pty.path());
    let all: Vec<u8> = (0..=255).collect();

    assert_eq!(pty.write(&all).unwrap(), 256);
    let mut received = vec![0; 512];
    let mut length = 0;
    wait_for("bytes at the host", || {
        length += host.read(&mut received[length..]).unwrap_or(0);
        length >= 256
    });
    assert_eq!(received[..length], all);

    host.write_all(&all).unwrap();
    let mut length = 0;
    wait_for("bytes at the board", || {
        length += pty.read(&mut received[length..]).unwrap();
        length >= 256
    });
    assert_eq!(received[..length], all);
    // No echo.
    assert!(host.read(&mut received).is_err());
}

#[test]
fn without_a_host_the_board_reads_nothing_and_no_error() {
    let pty = Pty::open(None).unwrap();
    drop(open(pty.path()));
    assert_eq!(pty.read(&mut [0; 16]).unwrap(), 0);
    let mut host = open(pty.path());
    host.write_all(b"again").unwrap();
    let mut buffer = [0; 16];
    wait_for("bytes", || pty.read(&mut buffer).unwrap() == 5);
}

#[test]
fn the_link_replaces_only_links_and_is_removed_with_the_terminal() {
    let directory = tempfile::tempdir().unwrap();
    let link = directory.path().join("board");
    std::os::unix::fs::symlink("/nowhere", &link).unwrap();
    let pty = Pty::open(Some(&link)).unwrap();
    assert_eq!(pty.path(), link);
    open(&link);
    drop(pty);
    assert!(std::fs::symlink_metadata(&link).is_err());

    std::fs::write(&link, "precious").unwrap();
    let error = Pty::open(Some(&link)).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("the path exists and is not a link"), "{text}");
    assert_eq!(std::fs::read_to_string(&link).unwrap(), "precious");
}

fn start(config: SimulationConfig, link: &Path) -> RealTimeSimulator {
    RealTimeSimulator::start(RealTimeConfig {
        simulation: config,
        pty_link: Some(link.to_owned()),
        ..RealTimeConfig::default()
    })
    .unwrap()
}

#[test]
fn telemetry_resumes_after_unplugging_and_plugging_in() {
    let directory = tempfile::tempdir().unwrap();
    let link = directory.path().join("board");
    let simulator = start(SimulationConfig::default(), &link);
    let mut port = open(&link);
    let mut host = ScriptedHost::default();
    let mut buffer = [0; 256];
    wait_for("telemetry", || {
        let count = port.read(&mut buffer).unwrap_or(0);
        host.take(&buffer[..count]);
        host.records >= 20
    });
    assert_eq!(host.damaged, 0);

    simulator.unplug().unwrap();
    wait_for("hang-up", || {
        // A hang-up reads as end of file or as an error, not as "would block".
        match port.read(&mut buffer) {
            Ok(count) => count == 0,
            Err(error) => error.kind() != std::io::ErrorKind::WouldBlock,
        }
    });
    assert!(!link.exists());

    assert_eq!(simulator.plug().unwrap(), link);
    let mut port = open(&link);
    let records = host.records;
    wait_for("telemetry", || {
        let count = port.read(&mut buffer).unwrap_or(0);
        host.take(&buffer[..count]);
        host.records >= records + 20
    });
    let finished = simulator.stop().unwrap();
    assert!(!link.exists());
    assert_eq!(finished.counters.datagrams_lost, 0);
    let points = &finished.trajectory;
    assert!(
        points
            .windows(2)
            .all(|pair| pair[1].monotonic_ns - pair[0].monotonic_ns == 5_000_000)
    );
    assert_eq!(points[0].monotonic_ns, finished.started_ns);
}

fn monotonic_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

#[test]
fn simulated_time_follows_real_time_without_running_ahead() {
    let directory = tempfile::tempdir().unwrap();
    let simulator = start(SimulationConfig::default(), &directory.path().join("b"));
    let mut before = 0;
    for _ in 0..20 {
        // A busy machine may delay a round, but not every round.
        wait_for("recent ground truth", || {
            let time_ns = simulator.truth().unwrap().monotonic_ns;
            let now_ns = monotonic_ns();
            assert!(before <= time_ns && time_ns <= now_ns);
            before = time_ns;
            now_ns - time_ns < 10_000_000
        });
    }
    assert!(simulator.counters().unwrap().rounds > 0);
}

fn request(message: &ClientMessage<'_>) -> Vec<u8> {
    let mut buffer = [0; 512];
    let length = encode::client_message(message, &mut buffer).unwrap();
    buffer[..length].to_vec()
}

const CONNECT: ClientMessage<'_> = ClientMessage::Connect(Connect {
    name: "test",
    requested_bitstream: None,
});

/// Receives `count` frames.
fn receive_frames(socket: &UdpSocket, count: usize) {
    socket.set_read_timeout(Some(TIMEOUT)).unwrap();
    let mut buffer = [0; 2048];
    let mut frames = 0;
    while frames < count {
        let (length, _) = socket.recv_from(&mut buffer).unwrap();
        let message = ServerMessage::decode(&buffer[..length], BitstreamVersion::V4_1).unwrap();
        frames += usize::from(matches!(message, ServerMessage::Frame(_)));
    }
}

#[test]
fn natnet_is_served_by_unicast() {
    let directory = tempfile::tempdir().unwrap();
    let simulator = start(SimulationConfig::default(), &directory.path().join("b"));
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    socket.set_read_timeout(Some(TIMEOUT)).unwrap();
    socket
        .send_to(&request(&CONNECT), simulator.command_address)
        .unwrap();
    let mut buffer = [0; 2048];
    let (length, from) = socket.recv_from(&mut buffer).unwrap();
    assert_eq!(from, simulator.command_address.into());
    match ServerMessage::decode(&buffer[..length], BitstreamVersion::V4_1) {
        Ok(ServerMessage::ServerInfo(info)) => {
            let channel = info.connection.unwrap().data_channel;
            assert!(!channel.multicast);
            assert_eq!(channel.port, simulator.data_address.port());
        }
        other => panic!("{other:?}"),
    }
    receive_frames(&socket, 20);
}

#[test]
fn natnet_is_served_by_multicast_on_the_loopback_interface() {
    let directory = tempfile::tempdir().unwrap();
    let mut config = SimulationConfig::default();
    config.natnet.multicast = true;
    let simulator = start(config, &directory.path().join("b"));
    let socket = socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::DGRAM, None).unwrap();
    socket.set_reuse_address(true).unwrap();
    let group = singletrack_mocap::DEFAULT_MULTICAST_GROUP;
    let address = std::net::SocketAddrV4::new(group, simulator.data_address.port());
    socket.bind(&address.into()).unwrap();
    socket
        .join_multicast_v4(&group, &Ipv4Addr::LOCALHOST)
        .unwrap();
    receive_frames(&socket.into(), 20);
}

#[test]
fn an_occupied_port_is_reported() {
    let taken = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = taken.local_addr().unwrap().port();
    let error = RealTimeSimulator::start(RealTimeConfig {
        udp: UdpConfig {
            command_port: port,
            ..UdpConfig::default()
        },
        ..RealTimeConfig::default()
    })
    .unwrap_err()
    .to_string();
    assert!(error.contains(&format!("127.0.0.1:{port}")), "{error}");
    assert!(error.contains("command port"), "{error}");
}
