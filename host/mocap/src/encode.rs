//! The NatNet wire format: values to bytes, for both sides.
//!
//! Every function writes one whole datagram to the front of `out` and returns
//! its length. The server's half feeds simulated cameras and tests.

use crate::codec::{
    BitstreamVersion, CameraTicks, ClientMessage, Echo, FrameFlags, HEADER_LEN, MAX_DATAGRAM_LEN,
    MessageId, RigidBody, RigidBodyDefinition, SENDER_NAME_LEN, ServerInfo, dataset,
};

/// The length of the datagram, or why there is none.
pub type Encoded = Result<usize, EncodeError>;

/// Why a message can't be encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The buffer ends before the message does.
    #[error("{field} does not fit into the {capacity} bytes of the buffer")]
    BufferTooSmall {
        /// The field that did not fit.
        field: &'static str,
        /// Length of the buffer.
        capacity: usize,
    },
    /// A count or size beyond what the wire or a datagram can carry.
    #[error("{field} is {value}, more than the wire can carry")]
    CountOutOfRange {
        /// The count.
        field: &'static str,
        /// Its value.
        value: usize,
    },
    /// A NUL inside a string: it would end the string on the wire.
    #[error("{field} contains a NUL")]
    InteriorNul {
        /// The string.
        field: &'static str,
    },
    /// A name longer than its fixed field.
    #[error("{field} is {len} bytes long, at most {max} fit")]
    NameTooLong {
        /// The name.
        field: &'static str,
        /// Its length.
        len: usize,
        /// The limit.
        max: usize,
    },
}

/// Encodes any message of a client.
///
/// # Errors
/// The buffer is too small, or a text contains a NUL or is too long.
pub fn client_message(message: &ClientMessage<'_>, out: &mut [u8]) -> Encoded {
    let mut writer = Writer::new(out);
    let id = match message {
        ClientMessage::Connect(connect) => {
            writer.padded_name(connect.name, "client name");
            writer.bytes(&[0; 4], "client application version");
            writer.bytes(&BitstreamVersion::V4_1.to_wire(), "client NatNet version");
            writer.u8(0, "subscribed data only");
            let requested = connect.requested_bitstream.unwrap_or_default();
            writer.bytes(&requested, "requested bitstream");
            MessageId::Connect
        }
        ClientMessage::Request(text) => {
            writer.c_bytes(text.as_bytes(), "request");
            MessageId::Request
        }
        ClientMessage::EchoRequest { client_stamp } => {
            writer.u64(*client_stamp, "echo client stamp");
            MessageId::EchoRequest
        }
        ClientMessage::RequestModelDefinitions => MessageId::RequestModelDefinitions,
        ClientMessage::KeepAlive => MessageId::KeepAlive,
        ClientMessage::Disconnect => MessageId::Disconnect,
        ClientMessage::Discovery => MessageId::Discovery,
    };
    writer.finish(id)
}

/// Encodes the answer to CONNECT: the long form when `info` has a connection
/// (3.0 and newer servers), else the short one.
///
/// # Errors
/// The buffer is too small, or the name contains a NUL or is too long.
pub fn server_info(info: &ServerInfo<'_>, out: &mut [u8]) -> Encoded {
    let mut writer = Writer::new(out);
    writer.padded_name(info.application, "server name");
    writer.bytes(&info.application_version, "server application version");
    writer.bytes(&info.natnet_version, "server NatNet version");
    if let Some(connection) = &info.connection {
        let ticks_per_second = connection.ticks_per_second.map_or(0, u64::from);
        writer.u64(ticks_per_second, "clock frequency");
        writer.u16(connection.data_channel.port, "data port");
        writer.u8(connection.data_channel.multicast.into(), "multicast flag");
        writer.bytes(&connection.data_channel.group.octets(), "multicast group");
    }
    writer.finish(MessageId::ServerInfo)
}

/// Encodes the answer to an echo request.
///
/// # Errors
/// The buffer is too small.
pub fn echo_response(echo: Echo, out: &mut [u8]) -> Encoded {
    let mut writer = Writer::new(out);
    writer.u64(echo.client_stamp, "echo client stamp");
    writer.u64(echo.server_ticks, "echo server ticks");
    writer.finish(MessageId::EchoResponse)
}

/// Encodes the answer to a text request as a status; 0 is success.
///
/// # Errors
/// The buffer is too small.
pub fn response_status(status: i32, out: &mut [u8]) -> Encoded {
    let mut writer = Writer::new(out);
    writer.i32(status, "response status");
    writer.finish(MessageId::Response)
}

/// Encodes the server's disconnect message.
///
/// # Errors
/// The buffer is too small.
pub fn disconnect(out: &mut [u8]) -> Encoded {
    Writer::new(out).finish(MessageId::Disconnect)
}

/// Encodes the answer to a request that the server does not understand.
///
/// # Errors
/// The buffer is too small.
pub fn unrecognized(out: &mut [u8]) -> Encoded {
    Writer::new(out).finish(MessageId::Unrecognized)
}

/// One entry of the model definitions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Dataset<'a> {
    /// A rigid body, without its markers.
    RigidBody(RigidBodyDefinition<'a>),
    /// A named set of markers.
    MarkerSet {
        /// Its name.
        name: &'a str,
        /// Its markers' names.
        marker_names: &'a [&'a str],
    },
}

/// Encodes the answer to a request for model definitions.
///
/// # Errors
/// The buffer is too small, or a name contains a NUL.
pub fn model_definitions(
    version: BitstreamVersion,
    datasets: &[Dataset<'_>],
    out: &mut [u8],
) -> Encoded {
    let mut writer = Writer::new(out);
    writer.count(datasets.len(), "dataset count");
    for dataset in datasets {
        writer.i32(dataset.type_id(), "dataset type");
        writer.sized(version, "dataset size", |writer| {
            dataset.write(writer, version);
        });
    }
    writer.finish(MessageId::ModelDefinitions)
}

impl Dataset<'_> {
    const fn type_id(&self) -> i32 {
        match self {
            Self::MarkerSet { .. } => dataset::MARKER_SET,
            Self::RigidBody(_) => dataset::RIGID_BODY,
        }
    }

    fn write(&self, writer: &mut Writer<'_>, version: BitstreamVersion) {
        match self {
            Self::RigidBody(definition) => {
                writer.c_bytes(definition.name, "rigid body name");
                writer.i32(definition.id, "rigid body id");
                writer.i32(definition.parent_id, "rigid body parent");
                writer.f32s(&definition.offset_m, "rigid body offset");
                if version >= BitstreamVersion::V4_2 {
                    writer.f32s(&[0.0, 0.0, 0.0, 1.0], "rigid body rotation");
                }
                if version >= BitstreamVersion::V3_0 {
                    writer.count(0, "definition marker count");
                }
            }
            Self::MarkerSet { name, marker_names } => {
                writer.c_bytes(name.as_bytes(), "marker set name");
                writer.count(marker_names.len(), "marker name count");
                for name in *marker_names {
                    writer.c_bytes(name.as_bytes(), "marker name");
                }
            }
        }
    }
}

/// The content of a frame. A field that the version does not have is left out: ticks
/// before 3.0, latency from 3.0 on. All other sections are empty, and other times zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameContent<'a> {
    /// The frame's number.
    pub number: i32,
    /// Named sets of markers.
    pub marker_sets: &'a [MarkerSet<'a>],
    /// The rigid bodies, tracked or not.
    pub rigid_bodies: &'a [RigidBody],
    /// Labelled markers.
    pub labelled_markers: &'a [LabelledMarker],
    /// Time of the frame in seconds.
    pub timestamp_s: f64,
    /// Exposure, reception and transmission in ticks (from 3.0 on).
    pub ticks: CameraTicks,
    /// Latency (before 3.0).
    pub latency: f32,
    /// The frame's flags.
    pub flags: FrameFlags,
}

/// A named set of markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerSet<'a> {
    /// Its name.
    pub name: &'a str,
    /// Positions in metres.
    pub markers_m: &'a [[f32; 3]],
}

/// A labelled marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelledMarker {
    /// Its id: model in the upper half, member in the lower.
    pub id: i32,
    /// Position in metres.
    pub position_m: [f32; 3],
    /// Diameter in metres.
    pub size_m: f32,
    /// Parameter bits.
    pub params: u16,
    /// Residual in metres (from 3.0 on).
    pub residual_m: f32,
}

/// Encodes one frame.
///
/// # Errors
/// The buffer is too small, or a name contains a NUL.
pub fn frame(version: BitstreamVersion, content: &FrameContent<'_>, out: &mut [u8]) -> Encoded {
    let mut writer = Writer::new(out);
    writer.i32(content.number, "frame number");
    let sets = content.marker_sets;
    writer.section(version, sets, "marker sets", |writer, set| {
        writer.c_bytes(set.name.as_bytes(), "marker set name");
        writer.count(set.markers_m.len(), "marker count");
        writer.f32s(set.markers_m.as_flattened(), "marker");
    });
    writer.empty(version, "other markers");
    let bodies = content.rigid_bodies;
    writer.section(version, bodies, "rigid bodies", |writer, body| {
        writer.i32(body.id, "rigid body id");
        writer.f32s(&body.position_m, "rigid body position");
        writer.f32s(&body.orientation_xyzw, "rigid body orientation");
        if version < BitstreamVersion::V3_0 {
            writer.count(0, "rigid body marker count");
        }
        writer.f32(body.mean_error_m, "rigid body mean error");
        writer.u16(body.params, "rigid body parameters");
    });
    writer.empty(version, "skeletons");
    if version >= BitstreamVersion::V4_1 {
        writer.empty(version, "assets");
    }
    let labelled = content.labelled_markers;
    writer.section(version, labelled, "labelled markers", |writer, marker| {
        writer.i32(marker.id, "labelled marker id");
        writer.f32s(&marker.position_m, "labelled marker position");
        writer.f32(marker.size_m, "labelled marker size");
        writer.u16(marker.params, "labelled marker parameters");
        if version >= BitstreamVersion::V3_0 {
            writer.f32(marker.residual_m, "labelled marker residual");
        }
    });
    if version >= BitstreamVersion::V2_9 {
        writer.empty(version, "force plates");
    }
    if version >= BitstreamVersion::V2_11 {
        writer.empty(version, "devices");
    }
    if version < BitstreamVersion::V3_0 {
        writer.f32(content.latency, "latency");
    }
    writer.u64(0, "timecode");
    writer.bytes(&content.timestamp_s.to_le_bytes(), "timestamp");
    if version >= BitstreamVersion::V3_0 {
        writer.u64(content.ticks.mid_exposure, "mid-exposure ticks");
        writer.u64(content.ticks.received, "received ticks");
        writer.u64(content.ticks.transmit, "transmit ticks");
    }
    if version >= BitstreamVersion::V4_1 {
        writer.u64(0, "precision time");
    }
    writer.u16(content.flags.0, "frame flags");
    writer.i32(0, "end tag");
    writer.finish(MessageId::Frame)
}

/// Writes a message, little-endian, at most to the end of `out`. [`finish`](Self::finish) returns the first error; nothing is written after it.
struct Writer<'a> {
    out: &'a mut [u8],
    len: usize,
    error: Option<EncodeError>,
}

impl<'a> Writer<'a> {
    /// Begins a message, with room for the header.
    fn new(out: &'a mut [u8]) -> Self {
        let (len, error) = (0, None);
        let mut writer = Self { out, len, error };
        writer.u16(0, "message id");
        writer.u16(0, "payload length");
        writer
    }

    /// Fills in the header and returns the datagram's length.
    fn finish(self, id: MessageId) -> Encoded {
        if let Some(error) = self.error {
            return Err(error);
        }
        if self.len > MAX_DATAGRAM_LEN {
            return Err(EncodeError::CountOutOfRange {
                field: "message",
                value: self.len,
            });
        }
        // No datagram is as long as the number allows.
        let payload = self.len.saturating_sub(HEADER_LEN) as u16;
        if let Some((header, _)) = self.out.split_first_chunk_mut() {
            let ([a, b], [c, d]) = ((id as u16).to_le_bytes(), payload.to_le_bytes());
            *header = [a, b, c, d];
        }
        Ok(self.len)
    }

    fn fail(&mut self, error: EncodeError) {
        self.error.get_or_insert(error);
    }

    fn bytes(&mut self, bytes: &[u8], field: &'static str) {
        let capacity = self.out.len();
        let end = self.len.saturating_add(bytes.len());
        match self.out.get_mut(self.len..end) {
            Some(slot) if self.error.is_none() => {
                slot.copy_from_slice(bytes);
                self.len = end;
            }
            _ => self.fail(EncodeError::BufferTooSmall { field, capacity }),
        }
    }

    fn u8(&mut self, value: u8, field: &'static str) {
        self.bytes(&[value], field);
    }

    fn u16(&mut self, value: u16, field: &'static str) {
        self.bytes(&value.to_le_bytes(), field);
    }

    fn i32(&mut self, value: i32, field: &'static str) {
        self.bytes(&value.to_le_bytes(), field);
    }

    fn u64(&mut self, value: u64, field: &'static str) {
        self.bytes(&value.to_le_bytes(), field);
    }

    fn f32(&mut self, value: f32, field: &'static str) {
        self.bytes(&value.to_le_bytes(), field);
    }

    fn f32s(&mut self, values: &[f32], field: &'static str) {
        values.iter().for_each(|value| self.f32(*value, field));
    }

    fn count(&mut self, value: usize, field: &'static str) {
        match i32::try_from(value) {
            Ok(count) => self.i32(count, field),
            Err(_) => self.fail(EncodeError::CountOutOfRange { field, value }),
        }
    }

    /// A text, and the NUL that ends it.
    fn c_bytes(&mut self, text: &[u8], field: &'static str) {
        if text.contains(&0) {
            self.fail(EncodeError::InteriorNul { field });
        }
        self.bytes(text, field);
        self.u8(0, field);
    }

    /// A name of a sender in a field of [`SENDER_NAME_LEN`] bytes, padded with zeros, NUL included.
    fn padded_name(&mut self, name: &str, field: &'static str) {
        let (len, max) = (name.len(), SENDER_NAME_LEN - 1);
        if name.contains('\0') {
            self.fail(EncodeError::InteriorNul { field });
        }
        let mut padded = [0; SENDER_NAME_LEN];
        match padded.get_mut(..len) {
            Some(slot) if len <= max => slot.copy_from_slice(name.as_bytes()),
            _ => self.fail(EncodeError::NameTooLong { field, len, max }),
        }
        self.bytes(&padded, field);
    }

    /// Writes one section of a frame.
    fn section<T>(
        &mut self,
        version: BitstreamVersion,
        entries: &[T],
        field: &'static str,
        write: impl Fn(&mut Self, &T),
    ) {
        self.count(entries.len(), field);
        self.sized(version, field, |writer| {
            entries.iter().for_each(|entry| write(writer, entry));
        });
    }

    fn empty(&mut self, version: BitstreamVersion, field: &'static str) {
        self.section::<()>(version, &[], field, |_, ()| {});
    }

    /// Writes a part, before it its size if the version has one.
    fn sized(
        &mut self,
        version: BitstreamVersion,
        field: &'static str,
        write: impl FnOnce(&mut Self),
    ) {
        if version < BitstreamVersion::V4_1 {
            return write(self);
        }
        self.i32(0, field);
        let start = self.len;
        write(self);
        let value = self.len.saturating_sub(start);
        let before = self.out.get_mut(..start);
        let slot = before.and_then(|before| before.last_chunk_mut());
        match (i32::try_from(value), slot) {
            (Ok(size), Some(slot)) if self.error.is_none() => *slot = size.to_le_bytes(),
            _ => self.fail(EncodeError::CountOutOfRange { field, value }),
        }
    }
}
