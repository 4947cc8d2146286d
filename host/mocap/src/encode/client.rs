//! Messages from a client.

use super::{error::EncodeError, writer::Writer};
use crate::codec::{BitstreamVersion, ClientMessage, MessageId, SENDER_NAME_LEN};

/// Encodes any message of a client.
///
/// # Errors
/// The buffer is too small, or a text contains a NUL or is too long.
pub fn client_message(message: &ClientMessage<'_>, out: &mut [u8]) -> Result<usize, EncodeError> {
    let id = match message {
        ClientMessage::Connect(_) => MessageId::Connect,
        ClientMessage::Request(_) => MessageId::Request,
        ClientMessage::RequestModelDefinitions => MessageId::RequestModelDefinitions,
        ClientMessage::KeepAlive => MessageId::KeepAlive,
        ClientMessage::Disconnect => MessageId::Disconnect,
        ClientMessage::EchoRequest { .. } => MessageId::EchoRequest,
        ClientMessage::Discovery => MessageId::Discovery,
    };
    let mut writer = Writer::message(out, id)?;
    match message {
        ClientMessage::Connect(connect) => {
            writer.padded_name::<SENDER_NAME_LEN>(connect.name, "client name")?;
            writer.bytes(&[0; 4], "client application version")?;
            writer.bytes(&BitstreamVersion::V4_1.to_wire(), "client NatNet version")?;
            writer.u8(0, "subscribed data only")?;
            let requested = connect.requested_bitstream.unwrap_or_default();
            writer.bytes(&requested, "requested bitstream")?;
        }
        ClientMessage::Request(text) => writer.c_str(text, "request")?,
        ClientMessage::EchoRequest { client_stamp } => {
            writer.u64(*client_stamp, "echo client stamp")?;
        }
        ClientMessage::RequestModelDefinitions
        | ClientMessage::KeepAlive
        | ClientMessage::Disconnect
        | ClientMessage::Discovery => {}
    }
    writer.finish()
}
