//! Messages from a server.

use super::{
    error::DecodeError,
    frame::Frame,
    model::ModelDefinitions,
    packet::{MessageId, Packet},
    reader::Reader,
    server_info::ServerInfo,
    version::BitstreamVersion,
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
            _ => {
                return Err(DecodeError::UnexpectedMessage {
                    id: packet.raw_id(),
                });
            }
        })
    }
}

impl<'a> Response<'a> {
    fn read(reader: &mut Reader<'a>) -> Result<Self, DecodeError> {
        // Four bytes are a status, even if they could also be a text.
        if reader.remaining() == 4 {
            reader.i32("response status").map(Self::Status)
        } else {
            read_text(reader).map(Self::Text)
        }
    }
}

/// A text that fills the rest of the payload, NUL included.
pub(super) fn read_text<'a>(reader: &mut Reader<'a>) -> Result<&'a str, DecodeError> {
    let text = reader.c_str("text")?;
    reader.finish("the text")?;
    Ok(text)
}
