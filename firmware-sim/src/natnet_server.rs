//! The cameras' NatNet server, without sockets.

use std::{
    net::{Ipv4Addr, SocketAddr},
    num::NonZeroU64,
};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};
use singletrack_mocap::{
    DEFAULT_DATA_PORT, DEFAULT_MULTICAST_GROUP,
    codec::{
        BitstreamVersion, ClientMessage, Connection, DataChannel, Echo, FrameFlags,
        RigidBodyDefinition, ServerInfo, bitstream_request,
    },
    encode::{self, Dataset, Encoded, FrameContent, LabelledMarker, MarkerSet},
};

use crate::cameras::{CameraFrame, CameraParameters, TICKS_PER_SECOND};

/// Parameters of the server.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NatNetParameters {
    /// The server's own bitstream version, such as "4.1".
    #[serde(
        serialize_with = "serialize_version",
        deserialize_with = "deserialize_version"
    )]
    pub bitstream: BitstreamVersion,
    /// Whether frames go to the multicast group instead of to each client.
    pub multicast: bool,
    /// The multicast group.
    pub group: Ipv4Addr,
    /// Silence after which a unicast client is dropped, in µs.
    pub keep_alive_timeout_us: u64,
    /// The address from which the server sends, if not the one at which it is asked: a
    /// computer with a second network card. An address of this machine in real time.
    pub sends_from: Option<Ipv4Addr>,
    /// The server is not running: it neither answers nor sends.
    pub is_off: bool,
}

impl Default for NatNetParameters {
    fn default() -> Self {
        Self {
            bitstream: BitstreamVersion::V4_1,
            multicast: false,
            group: DEFAULT_MULTICAST_GROUP,
            keep_alive_timeout_us: 5_000_000,
            sends_from: None,
            is_off: false,
        }
    }
}

/// Parses a bitstream version such as `4.1`.
///
/// # Errors
///
/// A message with the text and the supported versions.
pub fn parse_bitstream(text: &str) -> Result<BitstreamVersion, String> {
    let numbers = text
        .split_once('.')
        .and_then(|(major, minor)| Some((major.parse().ok()?, minor.parse().ok()?)));
    let (major, minor) = numbers.ok_or_else(|| {
        format!("\"{text}\" is not a bitstream version: write major.minor, for instance 4.1")
    })?;
    BitstreamVersion::new(major, minor).map_err(|error| error.to_string())
}

fn serialize_version<S: Serializer>(version: &BitstreamVersion, to: S) -> Result<S::Ok, S::Error> {
    to.collect_str(version)
}

fn deserialize_version<'de, D: Deserializer<'de>>(from: D) -> Result<BitstreamVersion, D::Error> {
    parse_bitstream(&String::deserialize(from)?).map_err(D::Error::custom)
}

/// Destination of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Destination {
    /// A client's address.
    Client(SocketAddr),
    /// The multicast group, at the data port.
    Group,
}

/// A datagram from the server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Datagram {
    /// Destination.
    pub to: Destination,
    /// Whether it is a frame, sent from the data port; answers are sent from the
    /// command port.
    pub is_frame: bool,
    /// The source address, if not the one at which the server is asked.
    pub from: Option<Ipv4Addr>,
    /// Contents.
    pub bytes: Vec<u8>,
}

/// Counters of the server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NatNetCounters {
    /// Valid datagrams.
    pub requests: u64,
    /// Invalid datagrams.
    pub malformed: u64,
    /// Frame datagrams sent, counted per receiver.
    pub frames: u64,
    /// Clients dropped for their silence.
    pub expired: u64,
    /// Messages that could not be encoded: a name is too long or contains NUL.
    pub unencodable: u64,
}

#[derive(Clone, Copy, Debug)]
struct Client {
    address: SocketAddr,
    bitstream: BitstreamVersion,
    last_received_us: u64,
}

/// Limit on the number of unicast clients.
const MAX_CLIENTS: usize = 16;

/// The server side of NatNet.
#[derive(Clone, Debug)]
pub struct NatNetServer {
    /// The parameters.
    pub parameters: NatNetParameters,
    /// The data port that is told to clients.
    pub data_port: u16,
    clients: Vec<Client>,
    /// The next frame says that the models have changed.
    pub(crate) models_changed: bool,
    /// The counters so far.
    pub counters: NatNetCounters,
    buffer: Vec<u8>,
}

impl NatNetServer {
    /// A server without clients.
    pub fn new(parameters: NatNetParameters) -> Self {
        Self {
            parameters,
            data_port: DEFAULT_DATA_PORT,
            clients: Vec::new(),
            models_changed: false,
            counters: NatNetCounters::default(),
            buffer: vec![0; 8192],
        }
    }

    /// Addresses of the unicast clients.
    pub fn clients(&self) -> impl Iterator<Item = SocketAddr> {
        self.clients.iter().map(|client| client.address)
    }

    /// Processes a datagram from a client and returns the answer, if any; `ticks`
    /// is the server's clock.
    pub fn handle_datagram(
        &mut self,
        now_us: u64,
        ticks: u64,
        cameras: &CameraParameters,
        from: SocketAddr,
        bytes: &[u8],
    ) -> Option<Datagram> {
        if self.parameters.is_off {
            return None;
        }
        let Ok(message) = ClientMessage::decode(bytes) else {
            self.counters.malformed += 1;
            return self.answer(from, encode::unrecognized);
        };
        self.counters.requests += 1;
        match message {
            ClientMessage::Connect(connect) => {
                let requested = connect.requested_bitstream.map(BitstreamVersion::from_wire);
                let bitstream = requested.and_then(Result::ok);
                let bitstream = bitstream.unwrap_or(self.parameters.bitstream);
                self.subscribe(now_us, from, bitstream);
                self.server_info(from)
            }
            ClientMessage::Discovery => self.server_info(from),
            ClientMessage::KeepAlive => {
                if let Some(client) = self.client_mut(from) {
                    client.last_received_us = now_us;
                }
                None
            }
            ClientMessage::Disconnect => {
                self.clients.retain(|client| client.address != from);
                None
            }
            ClientMessage::EchoRequest { client_stamp } => {
                let echo = Echo {
                    client_stamp,
                    server_ticks: ticks,
                };
                self.answer(from, |out| encode::echo_response(echo, out))
            }
            ClientMessage::RequestModelDefinitions => self.models(from, cameras),
            ClientMessage::Request(text) => self.text_request(from, text),
            _ => self.answer(from, encode::unrecognized),
        }
    }

    /// The datagrams of one frame for all receivers; none for a silent frame.
    pub fn frame(&mut self, now_us: u64, frame: &CameraFrame) -> Vec<Datagram> {
        let timeout_us = self.parameters.keep_alive_timeout_us;
        let before = self.clients.len();
        self.clients
            .retain(|client| now_us.saturating_sub(client.last_received_us) <= timeout_us);
        self.counters.expired += (before - self.clients.len()) as u64;
        if frame.silent || self.parameters.is_off {
            return Vec::new();
        }
        let receivers: Vec<_> = if self.parameters.multicast {
            vec![(Destination::Group, self.parameters.bitstream)]
        } else {
            self.clients
                .iter()
                .map(|client| (Destination::Client(client.address), client.bitstream))
                .collect()
        };
        let changed = core::mem::take(&mut self.models_changed);
        receivers
            .into_iter()
            .filter_map(|(to, version)| {
                let bytes = self.encoded(|out| encode_frame(version, frame, changed, out))?;
                self.counters.frames += 1;
                Some(Datagram {
                    to,
                    is_frame: true,
                    from: self.parameters.sends_from,
                    bytes,
                })
            })
            .collect()
    }

    fn client_mut(&mut self, address: SocketAddr) -> Option<&mut Client> {
        let mut clients = self.clients.iter_mut();
        clients.find(|client| client.address == address)
    }

    fn subscribe(&mut self, now_us: u64, address: SocketAddr, bitstream: BitstreamVersion) {
        let client = Client {
            address,
            bitstream,
            last_received_us: now_us,
        };
        if let Some(known) = self.client_mut(address) {
            *known = client;
        } else if self.clients.len() < MAX_CLIENTS {
            self.clients.push(client);
        }
    }

    fn server_info(&mut self, from: SocketAddr) -> Option<Datagram> {
        let p = self.parameters;
        let info = ServerInfo {
            application: "singletrack-sim",
            application_version: [1, 0, 0, 0],
            natnet_version: p.bitstream.to_wire(),
            connection: (p.bitstream >= BitstreamVersion::V3_0).then_some(Connection {
                ticks_per_second: NonZeroU64::new(TICKS_PER_SECOND),
                data_channel: DataChannel {
                    port: self.data_port,
                    multicast: p.multicast,
                    group: p.group,
                },
            }),
        };
        self.answer(from, |out| encode::server_info(&info, out))
    }

    fn models(&mut self, from: SocketAddr, cameras: &CameraParameters) -> Option<Datagram> {
        let p = self.parameters;
        let client = self.client_mut(from).filter(|_| !p.multicast);
        let version = client.map_or(p.bitstream, |client| client.bitstream);
        let mut models = vec![Dataset::MarkerSet {
            name: &cameras.car.name,
            marker_names: &MARKER_NAMES,
        }];
        models.extend(cameras.names().map(|(id, name)| {
            Dataset::RigidBody(RigidBodyDefinition {
                name: name.as_bytes(),
                id,
                parent_id: -1,
                offset_m: [0.0; 3],
            })
        }));
        self.answer(from, |out| encode::model_definitions(version, &models, out))
    }

    fn text_request(&mut self, from: SocketAddr, text: &str) -> Option<Datagram> {
        let Some(version) = bitstream_request(text) else {
            return self.answer(from, encode::unrecognized);
        };
        let mut status = 1;
        // All receivers share a multicast stream.
        if let Ok(version) = version
            && !self.parameters.multicast
            && let Some(client) = self.client_mut(from)
        {
            (client.bitstream, status) = (version, 0);
        }
        self.answer(from, |out| encode::response_status(status, out))
    }

    fn answer(
        &mut self,
        to: SocketAddr,
        encode: impl FnOnce(&mut [u8]) -> Encoded,
    ) -> Option<Datagram> {
        Some(Datagram {
            to: Destination::Client(to),
            is_frame: false,
            from: self.parameters.sends_from,
            bytes: self.encoded(encode)?,
        })
    }

    fn encoded(&mut self, encode: impl FnOnce(&mut [u8]) -> Encoded) -> Option<Vec<u8>> {
        let Ok(length) = encode(&mut self.buffer) else {
            self.counters.unencodable += 1;
            return None;
        };
        self.buffer.get(..length).map(<[u8]>::to_vec)
    }
}

const MARKER_NAMES: [&str; 3] = ["front", "left", "right"];

/// Encodes a frame with the markers of the bodies, as real servers send it.
fn encode_frame(
    version: BitstreamVersion,
    frame: &CameraFrame,
    models_changed: bool,
    out: &mut [u8],
) -> Encoded {
    let tracked = frame.bodies.iter().filter(|body| body.tracking_valid());
    let markers: Vec<[f32; 3]> = tracked.map(|body| body.position_m).collect();
    let labelled = markers.iter().zip(1..);
    let labelled: Vec<_> = labelled
        .map(|(&position_m, id)| LabelledMarker {
            id,
            position_m,
            size_m: 0.014,
            params: 0,
            residual_m: 0.000_2,
        })
        .collect();
    let all = MarkerSet {
        name: "all",
        markers_m: &markers,
    };
    let flags = models_changed.then_some(FrameFlags::MODELS_CHANGED);
    let content = FrameContent {
        number: frame.number,
        marker_sets: &[all],
        rigid_bodies: &frame.bodies,
        labelled_markers: &labelled,
        timestamp_s: frame.ticks.mid_exposure as f64 / TICKS_PER_SECOND as f64,
        ticks: frame.ticks,
        latency: (frame.sent_us - frame.exposed_us) as f32 * 1e-6,
        flags: flags.unwrap_or_default(),
    };
    encode::frame(version, &content, out)
}
