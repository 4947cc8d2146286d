//! What a server sends.

use super::error::DecodeError;
use super::frame::Frame;
use super::model::ModelDefinitions;
use super::packet::{MessageId, Packet};
use super::reader::Reader;
use super::server_info::ServerInfo;
use super::version::BitstreamVersion;

/// A message from a server, checked completely.
#[derive(Debug, Clone)]
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
    /// A text for people.
    Text(&'a str),
    /// The server leaves.
    Disconnect,
    /// The answer to an echo request.
    Echo(Echo),
    /// The server did not understand a request.
    Unrecognized,
}

/// The answer to a text request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Response<'a> {
    /// A status; 0 is success.
    Status(i32),
    /// A value.
    Text(&'a str),
}

/// The answer to an echo request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Echo {
    /// The stamp of the request, unchanged.
    pub client_stamp: u64,
    /// The server's high-resolution clock when it answered.
    pub server_ticks: u64,
}

impl<'a> ServerMessage<'a> {
    /// Decodes a datagram from a server that streams `version`.
    ///
    /// `version` matters for frames and model definitions only: before it is
    /// known, hand in any and look at [`Packet::message_id`] first.
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
        // Four bytes are a status, even where they could be a text.
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
