//! The example `natnet_client` against a server on the loopback interface.
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "test helpers fail the test that calls them"
)]

#[path = "../examples/natnet_client.rs"]
#[allow(dead_code, reason = "its main function is not called here")]
mod natnet_client;

use std::{
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    num::NonZeroU64,
    thread,
    time::{Duration, Instant},
};

use singletrack_mocap::{
    codec::{
        BitstreamVersion, CameraTicks, ClientMessage, Connection, DataChannel, Echo, RigidBody,
        RigidBodyDefinition, ServerInfo,
    },
    encode::{self, Dataset, FrameContent},
};

use natnet_client::Options;

const VERSION: BitstreamVersion = BitstreamVersion::V4_1;

const PATIENCE: Duration = Duration::from_secs(60);

/// Answers one client, and sends it frames, until it disconnects.
fn serve(socket: &UdpSocket) {
    let began = Instant::now();
    let ticks = || began.elapsed().as_nanos() as u64;
    let bodies = [
        RigidBody::tracked(3, [1.0, 0.25, -2.0], [0.5; 4]),
        RigidBody::tracked(4, [0.0; 3], [0.0; 4]).with_tracking_valid(false),
    ];
    let datasets = [("wand", 3), ("drone", 4)].map(|(name, id)| {
        Dataset::RigidBody(RigidBodyDefinition {
            name: name.as_bytes(),
            id,
            parent_id: -1,
            offset_m: [0.0; 3],
        })
    });
    let mut input = [0; 512];
    let mut out = [0; 2_048];
    let mut client: Option<SocketAddr> = None;
    let mut number = 0;
    loop {
        assert!(began.elapsed() < PATIENCE, "the client does not disconnect");
        // A time-out is the time of the next frame.
        let length = match (socket.recv_from(&mut input), client) {
            (Ok((length, source)), _) => {
                client = Some(source);
                match ClientMessage::decode(&input[..length]).unwrap() {
                    ClientMessage::Connect(_) => {
                        let info = ServerInfo {
                            application: "Scripted",
                            application_version: [1, 0, 0, 0],
                            natnet_version: VERSION.to_wire(),
                            connection: Some(Connection {
                                ticks_per_second: NonZeroU64::new(1_000_000_000),
                                data_channel: DataChannel {
                                    port: 1511,
                                    multicast: false,
                                    group: Ipv4Addr::new(239, 255, 42, 99),
                                },
                            }),
                        };
                        encode::server_info(&info, &mut out)
                    }
                    ClientMessage::RequestModelDefinitions => {
                        encode::model_definitions(VERSION, &datasets, &mut out)
                    }
                    ClientMessage::EchoRequest { client_stamp } => {
                        let echo = Echo {
                            client_stamp,
                            server_ticks: ticks(),
                        };
                        encode::echo_response(echo, &mut out)
                    }
                    ClientMessage::KeepAlive => continue,
                    ClientMessage::Disconnect => return,
                    other => panic!("not expected: {other:?}"),
                }
            }
            (Err(_), None) => continue,
            (Err(_), Some(_)) => {
                number += 1;
                let now = ticks();
                let content = FrameContent {
                    number,
                    rigid_bodies: &bodies,
                    timestamp_s: now as f64 * 1e-9,
                    ticks: CameraTicks {
                        mid_exposure: now,
                        received: now,
                        transmit: now,
                    },
                    ..FrameContent::default()
                };
                encode::frame(VERSION, &content, &mut out)
            }
        };
        socket
            .send_to(&out[..length.unwrap()], client.unwrap())
            .unwrap();
    }
}

#[test]
fn the_client_prints_every_body_by_name_and_disconnects() {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    socket
        .set_read_timeout(Some(Duration::from_millis(5)))
        .unwrap();
    let port = socket.local_addr().unwrap().port().to_string();
    let server = thread::spawn(move || serve(&socket));
    let arguments = ["127.0.0.1", "--command-port", &port, "--frames", "20"];
    let options = Options::parse(arguments.map(str::to_owned).into_iter()).unwrap();
    let mut out = vec![];
    natnet_client::run(&options, &mut out).unwrap();
    // It ends on the client's disconnect message.
    server.join().unwrap();
    let out = String::from_utf8(out).unwrap();
    let lines: Vec<_> = out.lines().collect();
    assert!(lines.len() >= 40, "{out}");
    let [.., wand, drone] = lines.as_slice() else {
        panic!("{out}");
    };
    assert!(
        wand.ends_with("wand (3)  1.0000 2.0000 0.2500 m  0.5000 -0.5000 0.5000 0.5000"),
        "{wand}"
    );
    assert!(wand.contains(" s ± "), "{wand}");
    assert!(drone.ends_with("drone (4)  not tracked"), "{drone}");
}

#[test]
fn a_wrong_command_line_is_answered_with_the_usage() {
    for arguments in [&[][..], &["camera"], &["127.0.0.1", "--up-axis", "x"]] {
        let arguments = arguments.iter().map(|&argument| argument.to_owned());
        let error = Options::parse(arguments).unwrap_err();
        assert!(error.to_string().starts_with("usage:"), "{error}");
    }
}
