//! Messages from a server, other than frames and model definitions.

use super::{error::EncodeError, writer::Writer};
use crate::codec::{Echo, MessageId, SENDER_NAME_LEN, ServerInfo};

/// Encodes the answer to CONNECT: the long form when `info` has a connection
/// (3.0 and newer servers), else the short one.
///
/// # Errors
/// The buffer is too small, or the name contains a NUL or is too long.
pub fn server_info(info: &ServerInfo<'_>, out: &mut [u8]) -> Result<usize, EncodeError> {
    let mut writer = Writer::message(out, MessageId::ServerInfo)?;
    writer.padded_name::<SENDER_NAME_LEN>(info.application, "server name")?;
    writer.bytes(&info.application_version, "server application version")?;
    writer.bytes(&info.natnet_version, "server NatNet version")?;
    if let Some(connection) = &info.connection {
        let ticks_per_second = connection.ticks_per_second.map_or(0, u64::from);
        writer.u64(ticks_per_second, "clock frequency")?;
        writer.u16(connection.data_channel.port, "data port")?;
        writer.u8(connection.data_channel.multicast.into(), "multicast flag")?;
        writer.bytes(&connection.data_channel.group.octets(), "multicast group")?;
    }
    writer.finish()
}

/// Encodes the answer to an echo request.
///
/// # Errors
/// The buffer is too small.
pub fn echo_response(echo: Echo, out: &mut [u8]) -> Result<usize, EncodeError> {
    let mut writer = Writer::message(out, MessageId::EchoResponse)?;
    writer.u64(echo.client_stamp, "echo client stamp")?;
    writer.u64(echo.server_ticks, "echo server ticks")?;
    writer.finish()
}

/// Encodes the answer to a text request as a status; 0 is success.
///
/// # Errors
/// The buffer is too small.
pub fn response_status(status: i32, out: &mut [u8]) -> Result<usize, EncodeError> {
    let mut writer = Writer::message(out, MessageId::Response)?;
    writer.i32(status, "response status")?;
    writer.finish()
}

/// Encodes the answer to a text request as a text.
///
/// # Errors
/// The buffer is too small, or the text contains a NUL, or is three bytes long:
/// with its NUL it would be read as a status.
pub fn response_text(text: &str, out: &mut [u8]) -> Result<usize, EncodeError> {
    if text.len() == 3 {
        return Err(EncodeError::AmbiguousResponse);
    }
    let mut writer = Writer::message(out, MessageId::Response)?;
    writer.c_str(text, "response")?;
    writer.finish()
}

/// Encodes a text for the operator.
///
/// # Errors
/// The buffer is too small, or the text contains a NUL.
pub fn text(text: &str, out: &mut [u8]) -> Result<usize, EncodeError> {
    let mut writer = Writer::message(out, MessageId::MessageString)?;
    writer.c_str(text, "text")?;
    writer.finish()
}

/// Encodes the server's disconnect message.
///
/// # Errors
/// The buffer is too small.
pub fn disconnect(out: &mut [u8]) -> Result<usize, EncodeError> {
    Writer::message(out, MessageId::Disconnect)?.finish()
}

/// Encodes the answer to a request that the server does not understand.
///
/// # Errors
/// The buffer is too small.
pub fn unrecognized(out: &mut [u8]) -> Result<usize, EncodeError> {
    Writer::message(out, MessageId::Unrecognized)?.finish()
}
