//! The NatNet wire format: values to bytes, for both sides.
//!
//! Every function writes one whole datagram to the front of `out` and returns
//! its length. The server's half feeds simulated cameras and tests. Frames are in `frame`; all other
//! messages are here.

mod frame;

use self::frame::Writer;
use crate::codec::{
    BitstreamVersion, ClientMessage, Echo, MessageId, RigidBodyDefinition, SENDER_NAME_LEN,
    ServerInfo, dataset,
};

pub use frame::{FrameContent, LabelledMarker, MarkerSet, frame};

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
            writer.padded_name::<SENDER_NAME_LEN>(connect.name, "client name");
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
    writer.padded_name::<SENDER_NAME_LEN>(info.application, "server name");
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
