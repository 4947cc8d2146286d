//! Hands recorded traffic of a VRPN server to a session, and compares the poses with what was sent.
//!
//! ```text
//! cargo run -p singletrack-mocap --example vrpn_traffic -- FOLDER
//! ```
//!
//! `FOLDER/capture.txt` has a payload a line: time in s, `udp` or `tcp`, source and destination port
//! with `>` between them, and the bytes in hexadecimal. `FOLDER/truth.csv` has a pose a line after its
//! header: name, sensor, stamp in s and us, position, quaternion x, y, z, w.
#![allow(clippy::print_stdout, reason = "an example prints")]

use std::{
    collections::{HashMap, HashSet},
    error::Error,
    fs,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    path::Path,
};

use singletrack_mocap::{
    BodyState, Input, LocalEnd, NameText, Output, Protocol, SessionConfig, Source, Transport,
    UpAxis,
};

const SERVER: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

/// A payload.
struct Payload {
    now_ns: u64,
    is_tcp: bool,
    source: u16,
    destination: u16,
    bytes: Vec<u8>,
}

/// A pose as bits: position and quaternion.
type Bits = [u64; 7];

/// A tracker's name, a sensor and its pose.
type Sent = (String, i32, Bits);

/// A connection of one client.
struct Connection {
    source: Source,
    received: Vec<u8>,
    names: HashMap<i32, String>,
    udp: bool,
    poses: Vec<Sent>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args()
        .nth(1)
        .ok_or("give the folder of the traffic")?;
    let folder = Path::new(&folder);
    let payloads = capture(&fs::read_to_string(folder.join("capture.txt"))?)?;
    let truth = truth(&fs::read_to_string(folder.join("truth.csv"))?)?;
    // The client is who has the other end of the server's streams.
    let mut connections: HashMap<u16, Connection> = HashMap::new();
    let mut current = None;
    let mut servers = HashSet::new();
    for payload in &payloads {
        if payload.is_tcp && payload.bytes.starts_with(b"vrpn:") && current != Some(payload.source)
        {
            // The server of a call-back speaks first, the client of a plain stream does.
            let server = if payload.destination == 3883 {
                payload.destination
            } else {
                payload.source
            };
            servers.insert(server);
        }
        if payload.is_tcp && servers.contains(&payload.source) {
            current = Some(payload.destination);
        }
        let Some(client) = current else {
            continue;
        };
        let connection = connections
            .entry(client)
            .or_insert_with(|| Connection::new(payload.now_ns));
        if payload.is_tcp && payload.destination == client {
            connection.received.extend_from_slice(&payload.bytes);
            let received = std::mem::take(&mut connection.received);
            let used = connection.take(payload.now_ns, Input::Stream(&received));
            connection.received = received.get(used..).unwrap_or_default().to_vec();
        } else if !payload.is_tcp && payload.destination != 3883 {
            connection.udp = true;
            let source = SocketAddr::new(SERVER, payload.source);
            let bytes = &payload.bytes;
            connection.take(payload.now_ns, Input::Datagram { source, bytes });
        }
    }
    let mut is_good = true;
    for (client, connection) in &connections {
        let equal = connection
            .poses
            .iter()
            .filter(|(name, id, bits)| truth.contains(&(name.clone(), id % 1_000, *bits)))
            .count();
        let poses = connection.poses.len();
        is_good &= equal == poses && poses > 0;
        println!(
            "client at port {client}: {poses} poses over {}, {equal} equal to what was sent, to the bit",
            if connection.udp { "UDP" } else { "TCP" },
        );
    }
    if is_good {
        Ok(())
    } else {
        Err("a pose differs".into())
    }
}

impl Connection {
    fn new(now_ns: u64) -> Self {
        let mut config =
            SessionConfig::new(SERVER, Transport::Unicast { bitstream: None }, UpAxis::Z);
        config.protocol = Protocol::Vrpn { sensor: 0 };
        let source = Source::new(config, None).unwrap_or_else(|error| unreachable!("{error}"));
        let mut connection = Self {
            source,
            received: Vec::new(),
            names: HashMap::new(),
            udp: false,
            poses: Vec::new(),
        };
        connection.source.handle_timeout(now_ns, &mut |_| {});
        connection.take(
            now_ns,
            Input::Opened(LocalEnd {
                address: SERVER,
                datagram_port: 0,
            }),
        );
        connection
    }

    fn take(&mut self, now_ns: u64, input: Input<'_>) -> usize {
        let (names, poses) = (&mut self.names, &mut self.poses);
        let used = self
            .source
            .handle_input(now_ns, input, &mut |output| match output {
                Output::Names(list) => list.for_each(&mut |id, name| {
                    names.insert(id / 1_000, NameText(name).to_string());
                }),
                Output::Frame(frame) => {
                    for body in frame.bodies() {
                        if let BodyState::Tracked(pose) = body.state {
                            let [x, y, z] = pose.position_m.map(f64::to_bits);
                            let [qx, qy, qz, qw] = pose.orientation_xyzw.map(f64::to_bits);
                            let name = names.get(&(body.id / 1_000)).cloned().unwrap_or_default();
                            poses.push((name, body.id, [x, y, z, qx, qy, qz, qw]));
                        }
                    }
                }
                Output::Event(_) => {}
            });
        while self.source.poll_transmit(now_ns).is_some() {}
        used
    }
}

fn capture(text: &str) -> Result<Vec<Payload>, Box<dyn Error>> {
    text.lines()
        .map(|line| {
            let fields: Vec<_> = line.split_whitespace().collect();
            let [time, kind, ports, hex] = fields[..] else {
                return Err(format!("not a payload: {line}").into());
            };
            let (source, destination) = ports.split_once('>').ok_or("no ports")?;
            let digits: Vec<_> = hex.as_bytes().chunks(2).collect();
            let bytes = digits
                .iter()
                .map(|pair| Ok(u8::from_str_radix(std::str::from_utf8(pair)?, 16)?))
                .collect::<Result<_, Box<dyn Error>>>()?;
            Ok(Payload {
                now_ns: (time.parse::<f64>()? * 1e9) as u64,
                is_tcp: kind == "tcp",
                source: source.parse()?,
                destination: destination.parse()?,
                bytes,
            })
        })
        .collect()
}

fn truth(text: &str) -> Result<HashSet<Sent>, Box<dyn Error>> {
    text.lines()
        .skip(1)
        .map(|line| {
            let fields: Vec<_> = line.split(',').collect();
            let [name, sensor, _, _, numbers @ ..] = &fields[..] else {
                return Err(format!("not a pose: {line}").into());
            };
            let bits: Vec<_> = numbers
                .iter()
                .map(|number| Ok(number.parse::<f64>()?.to_bits()))
                .collect::<Result<_, Box<dyn Error>>>()?;
            let bits: Bits = bits.try_into().map_err(|_| "not seven numbers")?;
            Ok(((*name).to_owned(), sensor.parse()?, bits))
        })
        .collect()
}
