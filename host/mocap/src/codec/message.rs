//! Messages from a server and from a client, other than the contents of frames; among them MODELDEF, the
//! models that the server tracks, with their names and ids.

use core::{net::Ipv4Addr, num::NonZeroU64};

use super::{
    BitstreamVersion, UnsupportedVersion,
    frame::Frame,
    packet::{DecodeError, Decoded, MessageId, Packet, Reader},
};

/// A message from a server. Every byte of it has been checked.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum ServerMessage<'a> {
    /// The answer to CONNECT.
    ServerInfo(ServerInfo<'a>),
    /// The answer to a text request.
    Response(Response<'a>),
    /// The answer to a request for model definitions.
    ModelDefinitions(ModelDefinitions<'a>),
    /// One frame of poses.
    Frame(Frame<'a>),
    /// A text for the operator.
    Text(&'a str),
    /// The server disconnects.
    Disconnect,
    /// The answer to an echo request.
    Echo(Echo),
    /// The server did not understand a request.
    Unrecognized,
}

/// The answer to a text request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response<'a> {
    /// A status; 0 is success.
    Status(i32),
    /// A value.
    Text(&'a str),
}

/// The answer to an echo request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Echo {
    /// The stamp of the request, unchanged.
    pub client_stamp: u64,
    /// The server's high-resolution clock when it answered.
    pub server_ticks: u64,
}

impl<'a> ServerMessage<'a> {
    /// Decodes a datagram from a server that streams `version`.
    ///
    /// Only frames and model definitions depend on `version`. Before it is known, pass
    /// any version, and use [`Packet::message_id`] to exclude those two messages.
    ///
    /// ```
    /// use singletrack_mocap::codec::{BitstreamVersion, RigidBody, ServerMessage};
    /// use singletrack_mocap::encode::{self, FrameContent};
    ///
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// let version = BitstreamVersion::V4_1;
    /// let body = RigidBody::tracked(7, [1.0, 0.5, -2.0], [0.0, 0.0, 0.0, 1.0]);
    /// let content = FrameContent {
    ///     number: 42,
    ///     rigid_bodies: &[body],
    ///     ..FrameContent::default()
    /// };
    /// let mut datagram = [0; 512];
    /// let len = encode::frame(version, &content, &mut datagram)?;
    ///
    /// let ServerMessage::Frame(frame) = ServerMessage::decode(&datagram[..len], version)? else {
    ///     panic!("a frame was encoded");
    /// };
    /// assert_eq!(frame.number, 42);
    /// assert_eq!(frame.rigid_bodies().next(), Some(body));
    ///
    /// // A datagram that is cut short is an error, which names the field.
    /// assert!(ServerMessage::decode(&datagram[..len - 1], version).is_err());
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// What is wrong with the datagram, and where.
    pub fn decode(datagram: &'a [u8], version: BitstreamVersion) -> Result<Self, DecodeError> {
        let packet = Packet::parse(datagram)?;
        let mut reader = packet.reader();
        Ok(match packet.message_id() {
            Some(MessageId::ServerInfo) => Self::ServerInfo(ServerInfo::decode(&packet)?),
            Some(MessageId::Response) => Self::Response(Response::read(&mut reader)?),
            Some(MessageId::ModelDefinitions) => {
                Self::ModelDefinitions(ModelDefinitions::decode(&packet, version)?)
            }
            Some(MessageId::Frame) => Self::Frame(Frame::decode(&packet, version)?),
            Some(MessageId::MessageString) => Self::Text(read_text(&mut reader)?),
            Some(MessageId::EchoResponse) => {
                let echo = Echo {
                    client_stamp: reader.u64("echo client stamp")?,
                    server_ticks: reader.u64("echo server ticks")?,
                };
                reader.finish("the echo response")?;
                Self::Echo(echo)
            }
            Some(MessageId::Disconnect) => {
                reader.finish("the disconnect message")?;
                Self::Disconnect
            }
            Some(MessageId::Unrecognized) => {
                reader.finish("the unrecognized message")?;
                Self::Unrecognized
            }
            _ => return Err(packet.unexpected()),
        })
    }
}

impl<'a> Response<'a> {
    fn read(reader: &mut Reader<'a>) -> Decoded<Self> {
        // Four bytes are a status, even if they could also be a text.
        if reader.remaining() == 4 {
            reader.i32("response status").map(Self::Status)
        } else {
            read_text(reader).map(Self::Text)
        }
    }
}

/// A text that fills the rest of the payload, NUL included.
fn read_text<'a>(reader: &mut Reader<'a>) -> Decoded<&'a str> {
    let text = reader.c_str("text")?;
    reader.finish("the text")?;
    Ok(text)
}

pub(crate) const SENDER_NAME_LEN: usize = 256;

/// Length of the block at the start of both CONNECT and SERVERINFO: a name of 256
/// bytes and two versions of four bytes.
pub const SENDER_LEN: usize = SENDER_NAME_LEN + 4 + 4;

const EXTENDED_LEN: usize = SENDER_LEN + 8 + 2 + 1 + 4;

/// The answer to CONNECT.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServerInfo<'a> {
    /// The application's name, for example `Motive`.
    pub application: &'a str,
    /// The application's version: major, minor, build, revision.
    pub application_version: [u8; 4],
    /// The server's NatNet version on the wire, supported or not: see
    /// [`bitstream`](Self::bitstream).
    pub natnet_version: [u8; 4],
    /// Clock and data channel, which servers send from 3.0 on.
    pub connection: Option<Connection>,
}

/// Clock and data channel of a server, from 3.0 on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Connection {
    /// Frequency of the high-resolution clock. `None` when the server sends 0.
    pub ticks_per_second: Option<NonZeroU64>,
    /// Where the server sends frames.
    pub data_channel: DataChannel,
}

/// Where a server sends frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataChannel {
    /// UDP port of the data.
    pub port: u16,
    /// Whether the server sends to the group instead of to each client.
    pub multicast: bool,
    /// The multicast group.
    pub group: Ipv4Addr,
}

impl<'a> ServerInfo<'a> {
    pub(super) fn decode(packet: &Packet<'a>) -> Decoded<Self> {
        let (message, actual) = ("SERVERINFO", packet.payload().len());
        if actual != SENDER_LEN && actual != EXTENDED_LEN {
            return Err(DecodeError::UnexpectedLength { message, actual });
        }
        let mut reader = packet.reader();
        let application = name_prefix(reader.take(SENDER_NAME_LEN, "server name")?);
        let application_version = reader.bytes4("server application version")?;
        let natnet_version = reader.bytes4("server NatNet version")?;
        let connection = if actual == EXTENDED_LEN {
            Some(Connection {
                ticks_per_second: NonZeroU64::new(reader.u64("clock frequency")?),
                data_channel: DataChannel {
                    port: reader.u16("data port")?,
                    multicast: reader.u8("multicast flag")? != 0,
                    group: Ipv4Addr::from_octets(reader.bytes4("multicast group")?),
                },
            })
        } else {
            None
        };
        reader.finish("the server information")?;
        Ok(Self {
            application,
            application_version,
            natnet_version,
            connection,
        })
    }

    /// The bitstream that the server sends unless another is requested.
    ///
    /// # Errors
    /// The bitstream is not supported.
    pub fn bitstream(&self) -> Result<BitstreamVersion, UnsupportedVersion> {
        BitstreamVersion::from_wire(self.natnet_version)
    }
}

/// The text of a fixed-size name. In real packets the bytes after the NUL are garbage.
/// A name that is not UTF-8 is cut before the first invalid byte.
fn name_prefix(field: &[u8]) -> &str {
    let name = field.split(|byte| *byte == 0).next().unwrap_or_default();
    let first = name.utf8_chunks().next();
    first.map_or("", |chunk| chunk.valid())
}

/// The longest known CONNECT: the sender block, a flag, a version, and up to two
/// further bytes that sample clients append.
const MAX_CONNECT_LEN: usize = SENDER_LEN + 1 + 4 + 2;

/// A message from a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ClientMessage<'a> {
    /// Asks the server to stream to this client and to identify itself.
    Connect(Connect<'a>),
    /// A text command, such as `Bitstream,4.1`: see [`bitstream_request`].
    Request(&'a str),
    /// Asks for the names and ids of the tracked models.
    RequestModelDefinitions,
    /// Asks the server to keep streaming.
    KeepAlive,
    /// The client disconnects.
    Disconnect,
    /// Asks for the server's clock.
    EchoRequest {
        /// The answer repeats it unchanged.
        client_stamp: u64,
    },
    /// Asks servers to identify themselves.
    Discovery,
}

/// The payload of CONNECT.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Connect<'a> {
    /// The client's name.
    pub name: &'a str,
    /// The requested bitstream, if any: the raw four bytes.
    pub requested_bitstream: Option<[u8; 4]>,
}

impl<'a> ClientMessage<'a> {
    /// Decodes a datagram from a client.
    ///
    /// One zero byte beyond the declared length is accepted: the vendor's own sample
    /// client sends it.
    ///
    /// # Errors
    /// What is wrong with the datagram, and where.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, DecodeError> {
        let packet = Packet::parse_before(datagram, &[0])?;
        let mut reader = packet.reader();
        Ok(match packet.message_id() {
            Some(MessageId::Connect) => Self::Connect(Connect::decode(&packet)?),
            Some(MessageId::Request) => Self::Request(read_text(&mut reader)?),
            Some(MessageId::RequestModelDefinitions) => Self::RequestModelDefinitions,
            Some(MessageId::KeepAlive) => Self::KeepAlive,
            Some(MessageId::Disconnect) => Self::Disconnect,
            Some(MessageId::Discovery) => Self::Discovery,
            Some(MessageId::EchoRequest) => {
                let client_stamp = reader.u64("echo client stamp")?;
                reader.finish("the echo request")?;
                Self::EchoRequest { client_stamp }
            }
            _ => return Err(packet.unexpected()),
        })
    }
}

impl<'a> Connect<'a> {
    /// Payloads of clients differ, down to an empty one: missing fields are allowed,
    /// and only a payload that is too long is an error.
    fn decode(packet: &Packet<'a>) -> Decoded<Self> {
        let payload = packet.payload();
        let (message, actual) = ("CONNECT", payload.len());
        if actual > MAX_CONNECT_LEN {
            return Err(DecodeError::UnexpectedLength { message, actual });
        }
        let name = payload.get(..SENDER_NAME_LEN).unwrap_or(payload);
        let rest = payload.get(SENDER_LEN + 1..).unwrap_or_default();
        let version = rest.first_chunk::<4>().copied();
        let requested_bitstream = version.filter(|version| *version != [0; 4]);
        Ok(Self {
            name: name_prefix(name),
            requested_bitstream,
        })
    }
}

/// The version that a text request such as `Bitstream,4.1` asks for; `None` when
/// the text is another command.
///
/// # Errors
/// The version is not supported. A version that is not two numbers counts as 0.0.
pub fn bitstream_request(text: &str) -> Option<Result<BitstreamVersion, UnsupportedVersion>> {
    let (command, version) = text.split_once(',')?;
    if !command.eq_ignore_ascii_case("bitstream") {
        return None;
    }
    let number = |text: &str| text.parse::<u8>().unwrap_or_default();
    let mut numbers = version.trim().split('.').map(number);
    let major = numbers.next().unwrap_or_default();
    let minor = numbers.next().unwrap_or_default();
    Some(BitstreamVersion::new(major, minor))
}

/// Dataset types of a model definition.
pub(crate) mod dataset {
    pub(crate) const MARKER_SET: i32 = 0;
    pub(crate) const RIGID_BODY: i32 = 1;
    pub(crate) const SKELETON: i32 = 2;
    pub(crate) const FORCE_PLATE: i32 = 3;
    pub(crate) const DEVICE: i32 = 4;
    pub(crate) const CAMERA: i32 = 5;
}

/// The definition of one rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidBodyDefinition<'a> {
    /// Its name, as in the server's asset list: bytes in the encoding of the server's computer, which
    /// is UTF-8 only by chance. [`NameText`](crate::NameText) shows it.
    pub name: &'a [u8],
    /// Its streaming id, as in the frames. The operator can change it.
    pub id: i32,
    /// Id of the parent body, or a negative number.
    pub parent_id: i32,
    /// Offset from the parent, in metres.
    pub offset_m: [f32; 3],
}

/// The definitions of all models that the server tracks.
#[derive(Clone, Debug)]
pub struct ModelDefinitions<'a> {
    /// Number of datasets, rigid bodies and others.
    pub dataset_count: usize,
    /// Why the first of those rigid bodies can't be read that have a size to skip them by; all others
    /// are listed.
    pub unreadable: Option<DecodeError>,
    rigid_bodies: RigidBodyDefinitions<'a>,
}

/// The rigid bodies among the definitions, in wire order.
#[derive(Clone, Debug)]
pub struct RigidBodyDefinitions<'a> {
    reader: Reader<'a>,
    datasets_left: usize,
    version: BitstreamVersion,
    unreadable: Option<DecodeError>,
}

impl<'a> ModelDefinitions<'a> {
    fn decode(packet: &Packet<'a>, version: BitstreamVersion) -> Decoded<Self> {
        let mut reader = packet.reader();
        let is_sized = version >= BitstreamVersion::V4_1;
        let header_len = if is_sized { 8 } else { 4 };
        let dataset_count = reader.count(header_len, "dataset count")?;
        let rigid_bodies = RigidBodyDefinitions {
            reader,
            datasets_left: dataset_count,
            version,
            unreadable: None,
        };
        let mut walk = rigid_bodies.clone();
        while walk.datasets_left > 0 {
            walk.read_dataset()?;
        }
        walk.reader.finish("the model definitions")?;
        Ok(Self {
            dataset_count,
            unreadable: walk.unreadable,
            rigid_bodies,
        })
    }

    /// The rigid bodies. Bones of skeletons and bodies of assets are not listed.
    pub fn rigid_bodies(&self) -> RigidBodyDefinitions<'a> {
        self.rigid_bodies.clone()
    }
}

impl<'a> RigidBodyDefinitions<'a> {
    /// Reads one dataset; `Some` when it is a rigid body that can be read.
    fn read_dataset(&mut self) -> Decoded<Option<RigidBodyDefinition<'a>>> {
        self.datasets_left = self.datasets_left.saturating_sub(1);
        let version = self.version;
        let offset = self.reader.offset();
        let type_id = self.reader.i32("dataset type")?;
        if version >= BitstreamVersion::V4_1 {
            let mut body = self.reader.sized("dataset size")?;
            if type_id != dataset::RIGID_BODY {
                return Ok(None);
            }
            let read = read_rigid_body(&mut body, version);
            let whole = |read| body.finish("the rigid body definition").map(|()| read);
            let read = read.and_then(whole);
            // One that nobody needs must not take the others along.
            if let Err(error) = read {
                self.unreadable.get_or_insert(error);
            }
            return Ok(read.ok());
        }
        let reader = &mut self.reader;
        match type_id {
            dataset::RIGID_BODY => return read_rigid_body(reader, version).map(Some),
            dataset::MARKER_SET => {
                reader.c_bytes("marker set name")?;
                skip_names(reader, "marker name count")?;
            }
            dataset::SKELETON => {
                reader.c_bytes("skeleton name")?;
                reader.i32("skeleton id")?;
                for _ in 0..reader.count(21, "bone count")? {
                    read_rigid_body(reader, version)?;
                }
            }
            dataset::FORCE_PLATE => {
                reader.i32("force plate id")?;
                reader.c_bytes("force plate serial number")?;
                // Width, length, origin; calibration 12 x 12; four corners.
                reader.skip(5 + 144 + 12, 4, "force plate geometry")?;
                reader.i32("force plate type")?;
                reader.i32("force plate channel type")?;
                skip_names(reader, "force plate channel count")?;
            }
            dataset::DEVICE => {
                reader.i32("device id")?;
                reader.c_bytes("device name")?;
                reader.c_bytes("device serial number")?;
                reader.i32("device type")?;
                reader.i32("device channel type")?;
                skip_names(reader, "device channel count")?;
            }
            dataset::CAMERA => {
                reader.c_bytes("camera name")?;
                reader.skip(3 + 4, 4, "camera pose")?;
            }
            _ => {
                return Err(DecodeError::UnknownDataset {
                    offset,
                    type_id,
                    version,
                });
            }
        }
        Ok(None)
    }
}

impl<'a> Iterator for RigidBodyDefinitions<'a> {
    type Item = RigidBodyDefinition<'a>;

    fn next(&mut self) -> Option<RigidBodyDefinition<'a>> {
        while self.datasets_left > 0 {
            if let Some(definition) = self.read_dataset().ok()? {
                return Some(definition);
            }
        }
        None
    }
}

fn read_rigid_body<'a>(
    reader: &mut Reader<'a>,
    version: BitstreamVersion,
) -> Decoded<RigidBodyDefinition<'a>> {
    let definition = RigidBodyDefinition {
        name: reader.c_bytes("rigid body name")?,
        id: reader.i32("rigid body id")?,
        parent_id: reader.i32("rigid body parent")?,
        offset_m: reader.f32s("rigid body offset")?,
    };
    if version >= BitstreamVersion::V4_2 {
        reader.skip(4, 4, "rigid body rotation")?;
    }
    if version >= BitstreamVersion::V3_0 {
        // Position and label of each, then the names.
        let markers = reader.count(12 + 4, "definition marker count")?;
        reader.skip(markers, 12 + 4, "definition markers")?;
        if version >= BitstreamVersion::V4_0 {
            for _ in 0..markers {
                reader.c_bytes("definition marker name")?;
            }
        }
    }
    Ok(definition)
}

fn skip_names(reader: &mut Reader<'_>, field: &'static str) -> Decoded<()> {
    let names = reader.count(1, field)?;
    (0..names).try_for_each(|_| reader.c_bytes("name").map(drop))
}
