//! The cameras' servers that are reached over TCP: their sockets, and what VRPN and the real-time
//! protocol of Qualisys QTM say.

use std::{
    fmt::Write as _,
    net::{Ipv4Addr, SocketAddr, SocketAddrV4, TcpListener, TcpStream, UdpSocket},
};

use singletrack_mocap::{
    codec::RigidBody,
    qualisys::packet::{self, ByteOrder, Component, FrameBody, Kind, Packet, write_frame},
    vrpn::message::{
        self, COOKIE, COOKIE_BEGINNING, Message, PING, PONG, POSE, Pose, SENDER_DESCRIPTION,
        TYPE_DESCRIPTION, UDP_DESCRIPTION,
    },
};

use crate::{
    cameras::{CameraFrame, CameraParameters},
    ports::{Bound, Client, Refused, Serving, StreamServer, UdpError, bind},
};

/// The protocol that is served.
#[derive(Debug)]
enum Protocol {
    Vrpn(Serving<VrpnServer>),
    /// In either byte order; and where clients ask who is there.
    Qtm(Serving<QtmServer>, Serving<QtmServer>, Option<UdpSocket>),
}

/// A server of poses over TCP.
#[derive(Debug)]
pub(crate) struct StreamServers {
    protocol: Protocol,
    udp: UdpSocket,
    pub(crate) address: SocketAddrV4,
}

impl StreamServers {
    /// A VRPN server on TCP and UDP of this port.
    pub(crate) fn vrpn(interface: Ipv4Addr, port: u16) -> Result<Self, UdpError> {
        let (listener, address) = listen(interface, port, "VRPN")?;
        let (udp, _) = bind(interface, address.port(), "VRPN's requests on UDP")?;
        Ok(Self {
            protocol: Protocol::Vrpn(Serving::new(VrpnServer, listener)),
            udp,
            address,
        })
    }

    /// A QTM server: little-endian on this port, big-endian on the next.
    pub(crate) fn qtm(interface: Ipv4Addr, port: u16) -> Result<Self, UdpError> {
        let (little, address) = listen(interface, port, "QTM, little-endian")?;
        let next = if port == 0 { 0 } else { port.saturating_add(1) };
        let (big, _) = listen(interface, next, "QTM, big-endian")?;
        // As far from the other ports as QTM's own, if it is free.
        let discovery = (port != 0)
            .then(|| bind(interface, port.saturating_add(3), "QTM's discovery"))
            .and_then(|bound| Some(bound.ok()?.0));
        let serving = |order, listener| Serving::new(QtmServer { order }, listener);
        Ok(Self {
            protocol: Protocol::Qtm(
                serving(ByteOrder::Little, little),
                serving(ByteOrder::Big, big),
                discovery,
            ),
            udp: bind(interface, 0, "QTM's frames on UDP")?.0,
            address,
        })
    }

    /// Serves what has arrived; `clock` is the server's, in µs.
    pub(crate) fn serve(&mut self, clock: &impl Fn() -> u64, cameras: &CameraParameters) {
        match &mut self.protocol {
            Protocol::Vrpn(serving) => {
                call_back(&self.udp, serving);
                serving.serve(clock, cameras);
            }
            Protocol::Qtm(little, big, discovery) => {
                if let Some(discovery) = discovery {
                    answer_discovery(discovery, self.address.port());
                }
                little.serve(clock, cameras);
                big.serve(clock, cameras);
            }
        }
    }

    /// Sends a frame; returns the number of datagrams that were lost.
    pub(crate) fn frame(&mut self, cameras: &CameraParameters, frame: &CameraFrame) -> u64 {
        match &mut self.protocol {
            Protocol::Vrpn(serving) => serving.frame(cameras, frame, &self.udp),
            Protocol::Qtm(little, big, _) => {
                little.frame(cameras, frame, &self.udp) + big.frame(cameras, frame, &self.udp)
            }
        }
    }
}

/// VRPN's clients may send the address and port at which they wait for the server's call.
fn call_back(udp: &UdpSocket, serving: &mut Serving<VrpnServer>) {
    let mut buffer = [0; 256];
    // One at a time: a client that does not answer delays the others.
    if let Ok((length, from)) = udp.recv_from(&mut buffer) {
        let text = buffer.get(..length).map(String::from_utf8_lossy);
        let port = text.as_deref().and_then(|text| {
            let (_, port) = text.trim_end_matches('\0').split_once(' ')?;
            port.trim().parse().ok()
        });
        let Some(port) = port else {
            return;
        };
        // The address is that of the datagram, and not what it says.
        let to = SocketAddr::new(from.ip(), port);
        if let Ok(stream) = TcpStream::connect_timeout(&to, CALL_BACK) {
            serving.welcome(stream, from.ip(), true);
        }
    }
}

/// Answers who asks for QTM servers: the answer goes to the port in the question.
fn answer_discovery(socket: &UdpSocket, little_endian_port: u16) {
    let mut buffer = [0; 64];
    while let Ok((length, from)) = socket.recv_from(&mut buffer) {
        let question = buffer.get(..length).unwrap_or_default();
        let Some(port) = packet::discovery_port(question) else {
            continue;
        };
        let base_port = little_endian_port.saturating_sub(1);
        let answer = packet::discovered("singletrack-sim, QTM 2.17, 0 cameras", base_port);
        let _ = socket.send_to(&answer, SocketAddr::new(from.ip(), port));
    }
}

/// The body with this id, if it is seen.
fn tracked(frame: &CameraFrame, id: i32) -> Option<&RigidBody> {
    let mut bodies = frame.bodies.iter();
    bodies.find(|body| body.id == id && body.tracking_valid())
}

/// How long the server waits for a client that it calls back.
const CALL_BACK: core::time::Duration = core::time::Duration::from_millis(5);

fn listen(interface: Ipv4Addr, port: u16, purpose: &'static str) -> Bound<TcpListener> {
    let address = SocketAddrV4::new(interface, port);
    UdpError::or(address, purpose, || {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let bound = match listener.local_addr()? {
            SocketAddr::V4(bound) => bound,
            SocketAddr::V6(_) => address,
        };
        Ok((listener, bound))
    })
}

/// The server's own numbers of its types. Those of its senders are the places of the bodies.
const POSE_TYPE: i32 = 0;
const PING_TYPE: i32 = 1;
const PONG_TYPE: i32 = 2;

/// The server side of VRPN: each rigid body is a tracker with sensor 0.
#[derive(Debug)]
struct VrpnServer;

/// What is known of a client of VRPN.
#[derive(Debug, Default)]
struct VrpnClient {
    welcomed: bool,
    /// The client's number of pings, and of the senders that are trackers here: as in VRPN's own
    /// server, only these answer.
    ping: Option<i32>,
    senders: Vec<i32>,
    sequence: u32,
}

impl VrpnClient {
    fn say(&mut self, stamp_us: u64, sender: i32, kind: i32, body: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let message = Message {
            stamp_us,
            sender,
            kind,
            body,
        };
        message.write(self.sequence, &mut |part| bytes.extend_from_slice(part));
        self.sequence = self.sequence.wrapping_add(1);
        bytes
    }
}

impl StreamServer for VrpnServer {
    type State = VrpnClient;

    fn greeting(&self, client: &Client<VrpnClient>) -> Vec<u8> {
        // A server that calls back speaks first.
        let cookie = client.was_called.then(|| COOKIE.to_vec());
        cookie.unwrap_or_default()
    }

    fn receive(
        &self,
        clock_us: u64,
        cameras: &CameraParameters,
        client: &mut Client<VrpnClient>,
        input: &[u8],
    ) -> Result<Option<usize>, Refused> {
        let state = &mut client.state;
        Ok(Some(if state.welcomed {
            let Some((message, length)) = Message::read(input).map_err(|_| Refused)? else {
                return Ok(None);
            };
            match message.kind {
                TYPE_DESCRIPTION if message.described() == Some(PING.as_bytes()) => {
                    state.ping = Some(message.sender);
                }
                UDP_DESCRIPTION => {
                    let port = u16::try_from(message.sender).ok();
                    let to = |port| SocketAddr::new(client.address, port);
                    client.datagrams_to = port.map(to);
                }
                SENDER_DESCRIPTION if state.senders.len() < 100 => {
                    let described = message.described();
                    let mut names = cameras.names().map(|(_, name)| Some(name.as_bytes()));
                    if names.any(|name| name == described) {
                        state.senders.push(message.sender);
                    }
                }
                kind if Some(kind) == state.ping && state.senders.contains(&message.sender) => {
                    let pong = state.say(clock_us, 0, PONG_TYPE, &[]);
                    client.output.extend(pong);
                }
                _ => {}
            }
            length
        } else {
            let seen = input.len().min(COOKIE_BEGINNING.len());
            if input.get(..seen) != COOKIE_BEGINNING.get(..seen) {
                return Err(Refused);
            }
            if input.len() < COOKIE.len() {
                return Ok(None);
            }
            state.welcomed = true;
            if !client.was_called {
                client.output.extend(COOKIE);
            }
            let descriptions = [
                (POSE_TYPE, TYPE_DESCRIPTION, POSE),
                (PING_TYPE, TYPE_DESCRIPTION, PING),
                (PONG_TYPE, TYPE_DESCRIPTION, PONG),
            ];
            let senders = (0..)
                .zip(cameras.names())
                .map(|(number, (_, name))| (number, SENDER_DESCRIPTION, name));
            for (number, kind, name) in descriptions.into_iter().chain(senders) {
                let said = state.say(clock_us, number, kind, &message::description(name));
                client.output.extend(said);
            }
            COOKIE.len()
        }))
    }

    fn frame(
        &self,
        cameras: &CameraParameters,
        frame: &CameraFrame,
        stamp_us: u64,
        client: &mut Client<VrpnClient>,
    ) -> Vec<u8> {
        let mut bytes = Vec::new();
        if !client.state.welcomed {
            return bytes;
        }
        for (number, (id, _)) in (0..).zip(cameras.names()) {
            // VRPN has no sign of a body that is not seen: nothing is reported.
            if let Some(body) = tracked(frame, id) {
                let pose = Pose {
                    sensor: 0,
                    position_m: body.position_m.map(f64::from),
                    orientation_xyzw: body.orientation_xyzw.map(f64::from),
                };
                bytes.extend(client.state.say(stamp_us, number, POSE_TYPE, &pose.body()));
            }
        }
        bytes
    }
}

/// The versions of QTM's protocol that are spoken: 1.8 to this.
const NEWEST_MINOR: u32 = 25;

/// The server side of QTM's protocol.
#[derive(Clone, Copy, Debug)]
struct QtmServer {
    order: ByteOrder,
}

/// What is known of a client of QTM.
#[derive(Debug, Default)]
struct QtmClient {
    /// The version's number after the point; without a request for a version it is one.
    minor: Option<u32>,
    stream: Option<Streamed>,
}

/// What is streamed to a client of QTM.
#[derive(Debug)]
struct Streamed {
    components: Vec<Component>,
    /// Every such frame.
    divisor: i32,
}

impl QtmServer {
    fn packet(self, kind: Kind, body: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        Packet { kind, body }.write(self.order, &mut |part| bytes.extend_from_slice(part));
        bytes
    }

    fn text(self, kind: Kind, text: &str) -> Vec<u8> {
        let mut body = text.as_bytes().to_vec();
        body.push(0);
        self.packet(kind, &body)
    }

    fn answer(
        self,
        cameras: &CameraParameters,
        client: &mut Client<QtmClient>,
        command: &str,
    ) -> Vec<u8> {
        let lower = command.to_lowercase();
        let mut words = lower.split_whitespace();
        let ok = |text: &str| self.text(Kind::Command, text);
        let refused = |text: &str| self.text(Kind::Error, text);
        match words.next() {
            Some("version") => {
                let wanted = words.next().and_then(|version| version.strip_prefix("1."));
                match wanted.and_then(|minor| minor.parse().ok()) {
                    Some(minor) if (8..=NEWEST_MINOR).contains(&minor) => {
                        client.state.minor = Some(minor);
                        ok(&format!("Version set to 1.{minor}"))
                    }
                    _ => refused("Version NOT supported"),
                }
            }
            Some("qtmversion") => ok("QTM Version is 2.17 (build 4000)"),
            Some("byteorder") => ok(match self.order {
                ByteOrder::Little => "Byte order is little endian",
                ByteOrder::Big => "Byte order is big endian",
            }),
            // The event "connected".
            Some("getstate") => self.packet(Kind::Event, &[1]),
            Some("getparameters") => {
                let with_bodies = words.any(|word| matches!(word, "6d" | "all"));
                let xml = parameters(client.state.minor.unwrap_or(1), cameras, with_bodies);
                self.text(Kind::Xml, &xml)
            }
            Some("streamframes") => {
                let rest: Vec<_> = words.collect();
                if rest.first() == Some(&"stop") {
                    client.state.stream = None;
                    return Vec::new();
                }
                let mut words = rest.iter();
                let to = words.find_map(|word| word.strip_prefix("udp:"));
                client.datagrams_to = to.and_then(|to| datagrams_to(client, to));
                let divisor = |word: &&str| word.strip_prefix("frequencydivisor:")?.parse().ok();
                let divisor = rest.iter().find_map(divisor);
                let mut components = Vec::new();
                for component in rest.iter().filter_map(|word| component(word)) {
                    if !components.contains(&component) {
                        components.push(component);
                    }
                }
                client.state.stream = Some(Streamed {
                    components,
                    divisor: divisor.unwrap_or(1).max(1),
                });
                Vec::new()
            }
            _ => refused("Command not supported"),
        }
    }
}

/// A component that this server has; it leaves out the others.
fn component(word: &str) -> Option<Component> {
    match word {
        "6d" => Some(Component::Bodies),
        "6dres" => Some(Component::WithResiduals),
        "6deuler" => Some(Component::EulerAngles),
        _ => None,
    }
}

/// Where datagrams go: a port at the client's address, or an address and a port.
fn datagrams_to(client: &Client<QtmClient>, to: &str) -> Option<SocketAddr> {
    match to.rsplit_once(':') {
        Some((address, port)) => Some(SocketAddr::new(address.parse().ok()?, port.parse().ok()?)),
        None => Some(SocketAddr::new(client.address, to.parse().ok()?)),
    }
}

/// The settings of QTM as XML.
fn parameters(minor: u32, cameras: &CameraParameters, with_bodies: bool) -> String {
    let mut xml = format!("<QTM_Parameters_Ver_1.{minor}>");
    if with_bodies {
        // Strings take what is written.
        let _ = write!(xml, "<The_6D><Bodies>{}</Bodies>", cameras.names().count());
        for (_, name) in cameras.names() {
            let name = name.replace('&', "&amp;").replace('<', "&lt;");
            let name = name.replace('>', "&gt;");
            let colour = if minor > 20 {
                "<Enabled>true</Enabled><Color R=\"0\" G=\"128\" B=\"0\"/>"
            } else {
                "<RGBColor>32768</RGBColor>"
            };
            let _ = write!(xml, "<Body><Name>{name}</Name>{colour}</Body>");
        }
        xml.push_str(
            "<Euler><First>Roll</First><Second>Pitch</Second><Third>Yaw</Third></Euler></The_6D>",
        );
    }
    let _ = write!(xml, "</QTM_Parameters_Ver_1.{minor}>");
    xml
}

impl StreamServer for QtmServer {
    type State = QtmClient;

    fn greeting(&self, _: &Client<QtmClient>) -> Vec<u8> {
        self.text(Kind::Command, "QTM RT Interface connected")
    }

    fn receive(
        &self,
        _: u64,
        cameras: &CameraParameters,
        client: &mut Client<QtmClient>,
        input: &[u8],
    ) -> Result<Option<usize>, Refused> {
        let Some((packet, length)) = Packet::read(self.order, input).map_err(|_| Refused)? else {
            return Ok(None);
        };
        if packet.kind == Kind::Command {
            let answer = self.answer(cameras, client, packet.text().unwrap_or_default());
            client.output.extend(answer);
        }
        Ok(Some(length))
    }

    fn frame(
        &self,
        cameras: &CameraParameters,
        frame: &CameraFrame,
        stamp_us: u64,
        client: &mut Client<QtmClient>,
    ) -> Vec<u8> {
        let mut bytes = Vec::new();
        let is_due = |streamed: &&Streamed| frame.number % streamed.divisor == 0;
        let Some(streamed) = client.state.stream.as_ref().filter(is_due) else {
            return bytes;
        };
        let bodies: Vec<_> = cameras
            .names()
            .map(|(id, _)| {
                tracked(frame, id).map_or(UNSEEN, |body| FrameBody {
                    position_mm: body.position_m.map(|metres| metres * 1e3),
                    axes: axes(body.orientation_xyzw),
                    residual_mm: body.mean_error_m * 1e3,
                })
            })
            .collect();
        write_frame(
            self.order,
            stamp_us,
            frame.number.cast_unsigned(),
            &bodies,
            &streamed.components,
            &mut |part| bytes.extend_from_slice(part),
        );
        bytes
    }
}

/// A body that is not seen.
const UNSEEN: FrameBody = FrameBody {
    position_mm: [f32::NAN; 3],
    axes: [[f32::NAN; 3]; 3],
    residual_mm: f32::NAN,
};

/// The columns of the rotation matrix.
fn axes(quaternion: [f32; 4]) -> [[f32; 3]; 3] {
    let [x, y, z, w] = quaternion.map(f64::from);
    let columns = [
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y + z * w),
            2.0 * (x * z - y * w),
        ],
        [
            2.0 * (x * y - z * w),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z + x * w),
        ],
        [
            2.0 * (x * z + y * w),
            2.0 * (y * z - x * w),
            1.0 - 2.0 * (x * x + y * y),
        ],
    ];
    columns.map(|column| column.map(|value| value as f32))
}
