//! The addresses of the cameras' server, and the sockets of NatNet.

use std::{
    io,
    net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket},
};

use serde::{Deserialize, Serialize};
use socket2::{Domain, Protocol, Socket, Type};

use crate::natnet_server::{Datagram, Destination};

/// Addresses of the cameras' server.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UdpConfig {
    /// Address of the interface, also for multicast frames. The default is this
    /// machine only.
    pub interface: Ipv4Addr,
    /// Port for commands, 1510 by default in NatNet; the TCP port of other servers; 0 selects a
    /// free one.
    pub command_port: u16,
    /// Port for frames, 1511 by default in NatNet; 0 selects a free one.
    pub data_port: u16,
}

impl Default for UdpConfig {
    fn default() -> Self {
        Self {
            interface: Ipv4Addr::LOCALHOST,
            command_port: 0,
            data_port: 0,
        }
    }
}

/// Error while opening a socket of the cameras' server.
#[derive(Debug, thiserror::Error)]
#[error(
    "can't serve the cameras on {address} ({purpose}): {source}; choose another port, or 0 for a free one"
)]
pub struct UdpError {
    /// Requested address.
    pub address: SocketAddrV4,
    /// Purpose of the socket.
    pub purpose: &'static str,
    /// The system's error.
    pub source: io::Error,
}

impl UdpError {
    /// What `open` returns, or this error for its error.
    pub(crate) fn or<T>(
        address: SocketAddrV4,
        purpose: &'static str,
        open: impl FnOnce() -> io::Result<T>,
    ) -> Result<T, Self> {
        open().map_err(|source| Self {
            address,
            purpose,
            source,
        })
    }
}

/// The NatNet server's sockets.
#[derive(Debug)]
pub(crate) struct NatNetSockets {
    command: UdpSocket,
    data: UdpSocket,
    command_address: SocketAddrV4,
    data_address: SocketAddrV4,
    group: SocketAddrV4,
    /// The second network card, which only sends.
    second: Option<UdpSocket>,
}

impl NatNetSockets {
    /// `second` is the address of a second network card.
    pub(crate) fn bind(
        config: &UdpConfig,
        group: Ipv4Addr,
        second: Option<Ipv4Addr>,
    ) -> Result<Self, UdpError> {
        let (command, command_address) =
            bind(config.interface, config.command_port, "command port")?;
        let (data, data_address) = bind(config.interface, config.data_port, "data port")?;
        let second = second
            .map(|address| bind(address, command_address.port(), "second network card"))
            .transpose()?;
        Ok(Self {
            second: second.map(|(socket, _)| socket),
            command,
            data,
            command_address,
            data_address,
            group: SocketAddrV4::new(group, data_address.port()),
        })
    }

    pub(crate) const fn command_address(&self) -> SocketAddrV4 {
        self.command_address
    }

    pub(crate) const fn data_address(&self) -> SocketAddrV4 {
        self.data_address
    }

    /// The next received datagram.
    pub(crate) fn receive(&self, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
        loop {
            match self.command.recv_from(buffer) {
                Ok(received) => return Some(received),
                // A client has gone: an ICMP error for an earlier frame.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
                Err(_) => return None,
            }
        }
    }

    /// Sends a datagram; returns false if it is lost.
    pub(crate) fn send(&self, datagram: &Datagram) -> bool {
        let to: SocketAddr = match datagram.to {
            Destination::Client(address) => address,
            Destination::Group => self.group.into(),
        };
        let socket = if let (Some(_), Some(second)) = (datagram.from, &self.second) {
            second
        } else if datagram.is_frame {
            &self.data
        } else {
            &self.command
        };
        socket.send_to(&datagram.bytes, to).is_ok()
    }
}

fn bind(
    interface: Ipv4Addr,
    port: u16,
    purpose: &'static str,
) -> Result<(UdpSocket, SocketAddrV4), UdpError> {
    let address = SocketAddrV4::new(interface, port);
    UdpError::or(address, purpose, || {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        socket.set_nonblocking(true)?;
        if purpose == "data port" {
            // Multicast clients on this machine bind the same port.
            socket.set_reuse_address(true)?;
        }
        socket.set_multicast_if_v4(&interface)?;
        socket.set_multicast_loop_v4(true)?;
        socket.set_multicast_ttl_v4(1)?;
        socket.bind(&address.into())?;
        let bound = socket.local_addr()?.as_socket_ipv4().unwrap_or(address);
        Ok((socket.into(), bound))
    })
}
