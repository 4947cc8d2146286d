//! The sockets to the motion capture.

use std::{
    io,
    net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket},
    os::fd::{AsFd, BorrowedFd},
};

use singletrack_core::{
    cameras::{Channel, Sockets, StreamEvent},
    config::{MotionCaptureSection, TransportKind},
};
use singletrack_mocap::Stream;
use socket2::{Domain, Protocol, Socket, Type};

use crate::mocap_stream::MocapStream;

/// One socket for unicast; a second one for the frames of multicast; and a stream for protocols
/// that have one.
#[derive(Debug)]
pub struct MocapSockets {
    command: UdpSocket,
    data: Option<UdpSocket>,
    stream: MocapStream,
    /// Whether the last datagram could be sent: the first that could not is logged.
    is_reachable: bool,
}

impl MocapSockets {
    /// Opens the sockets that the transport needs.
    ///
    /// # Errors
    ///
    /// An address can't be bound, or a group can't be joined.
    pub fn open(config: &MotionCaptureSection) -> Result<Self, String> {
        let command = bind(
            SocketAddrV4::new(config.interface, 0),
            "motion_capture.interface must be an address of this computer, or 0.0.0.0",
        )?;
        let data = match config.transport {
            TransportKind::Unicast | TransportKind::Tcp => None,
            TransportKind::Multicast => Some(join(config)?),
        };
        let datagram_port = command.local_addr().map_or(0, |address| address.port());
        Ok(Self {
            command,
            data,
            stream: MocapStream::new(datagram_port),
            is_reachable: true,
        })
    }

    /// The sockets, to poll them for what arrives.
    pub fn files(&self) -> heapless::Vec<BorrowedFd<'_>, 3> {
        core::iter::once(&self.command)
            .chain(&self.data)
            .map(AsFd::as_fd)
            .chain(self.stream.file())
            .collect()
    }

    /// Whether a stream is being opened, which no file tells.
    pub const fn is_opening(&self) -> bool {
        self.stream.is_opening()
    }
}

impl Sockets for MocapSockets {
    fn receive(&mut self, channel: Channel, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
        let socket = match channel {
            Channel::Command => &self.command,
            Channel::Data => self.data.as_ref()?,
        };
        // An error counts as a lost datagram.
        socket.recv_from(buffer).ok()
    }

    fn send(&mut self, to: SocketAddr, bytes: &[u8]) {
        let result = self.command.send_to(bytes, to);
        // The session repeats what matters.
        if let Err(error) = &result
            && self.is_reachable
        {
            tracing::warn!(server = %to, %error, "can't send to motion_capture.server");
        }
        self.is_reachable = result.is_ok();
    }

    fn stream(&mut self, wanted: Option<Stream>, received: &mut Vec<u8>) -> StreamEvent {
        self.stream.poll(wanted, received)
    }

    fn write_stream(&mut self, bytes: &[u8]) {
        self.stream.write(bytes);
    }
}

fn bind(address: SocketAddrV4, fix: &str) -> Result<UdpSocket, String> {
    let open = || -> io::Result<UdpSocket> {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        socket.set_nonblocking(true)?;
        if address.port() != 0 {
            // Other clients on this computer may listen to the same group.
            socket.set_reuse_address(true)?;
        }
        socket.bind(&address.into())?;
        Ok(socket.into())
    };
    open().map_err(|error| format!("motion capture: can't bind to {address}: {error}; {fix}"))
}

fn join(config: &MotionCaptureSection) -> Result<UdpSocket, String> {
    // Bound to the group's address, the socket receives its datagrams only.
    let address = SocketAddrV4::new(config.group, config.data_port);
    let socket = bind(
        address,
        "is motion_capture.data_port in use by a program that does not share it?",
    )?;
    let interface: Ipv4Addr = config.interface;
    socket
        .join_multicast_v4(&config.group, &interface)
        .map_err(|error| {
            format!(
                "motion capture: can't join {address}: {error}; motion_capture.interface must be \
                 this computer's address in the cameras' network"
            )
        })?;
    Ok(socket)
}
