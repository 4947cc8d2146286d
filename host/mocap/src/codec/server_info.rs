//! SERVERINFO: the server's name, bitstream, data channel and clock frequency.

use core::{net::Ipv4Addr, num::NonZeroU64};

use super::{
    error::DecodeError,
    packet::Packet,
    version::{BitstreamVersion, UnsupportedVersion},
};

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
    pub(super) fn decode(packet: &Packet<'a>) -> Result<Self, DecodeError> {
        let actual = packet.payload().len();
        if actual != SENDER_LEN && actual != EXTENDED_LEN {
            return Err(DecodeError::UnexpectedLength {
                message: "SERVERINFO",
                actual,
            });
        }
        let mut reader = packet.reader();
        let application = name_prefix(reader.take(SENDER_NAME_LEN, "server name")?);
        let application_version = reader.bytes4("server application version")?;
        let natnet_version = reader.bytes4("server NatNet version")?;
        let connection = if actual == EXTENDED_LEN {
            let ticks_per_second = NonZeroU64::new(reader.u64("clock frequency")?);
            Some(Connection {
                ticks_per_second,
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
    pub const fn bitstream(&self) -> Result<BitstreamVersion, UnsupportedVersion> {
        BitstreamVersion::from_wire(self.natnet_version)
    }
}

/// The text of a fixed-size name. In real packets the bytes after the NUL are garbage.
/// A name that is not UTF-8 is cut before the first invalid byte.
pub(super) fn name_prefix(field: &[u8]) -> &str {
    let name = field.split(|byte| *byte == 0).next().unwrap_or_default();
    match core::str::from_utf8(name) {
        Ok(name) => name,
        Err(error) => name
            .get(..error.valid_up_to())
            .and_then(|valid| core::str::from_utf8(valid).ok())
            .unwrap_or_default(),
    }
}
