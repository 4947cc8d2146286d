//! The cameras' servers that are reached over TCP.

use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, TcpListener, TcpStream, UdpSocket};

use singletrack_mocap::qualisys::packet::{self, ByteOrder};

use crate::{
    cameras::{CameraFrame, CameraParameters},
    qtm_server::QtmServer,
    sockets::{Bound, Serving, UdpError, bind},
    vrpn_server::VrpnServer,
};

/// The protocol that is served.
#[derive(Debug)]
enum Protocol {
    Vrpn(Serving<VrpnServer>),
    /// In either byte order; and where clients ask who is there.
    Qtm(Serving<QtmServer>, Serving<QtmServer>, Option<UdpSocket>),
}

/// A server of poses over TCP.
#[derive(Debug)]
pub(crate) struct StreamServers {
    protocol: Protocol,
    udp: UdpSocket,
    pub(crate) address: SocketAddrV4,
}

impl StreamServers {
    /// A VRPN server on TCP and UDP of this port.
    pub(crate) fn vrpn(interface: Ipv4Addr, port: u16) -> Result<Self, UdpError> {
        let (listener, address) = listen(interface, port, "VRPN")?;
        let (udp, _) = bind(interface, address.port(), "VRPN's requests on UDP")?;
        Ok(Self {
            protocol: Protocol::Vrpn(Serving::new(VrpnServer, listener)),
            udp,
            address,
        })
    }

    /// A QTM server: little-endian on this port, big-endian on the next.
    pub(crate) fn qtm(interface: Ipv4Addr, port: u16) -> Result<Self, UdpError> {
        let (little, address) = listen(interface, port, "QTM, little-endian")?;
        let next = if port == 0 { 0 } else { port.saturating_add(1) };
        let (big, _) = listen(interface, next, "QTM, big-endian")?;
        // As far from the other ports as QTM's own, if it is free.
        let discovery = (port != 0)
            .then(|| bind(interface, port.saturating_add(3), "QTM's discovery"))
            .and_then(|bound| Some(bound.ok()?.0));
        let serving = |order, listener| Serving::new(QtmServer { order }, listener);
        Ok(Self {
            protocol: Protocol::Qtm(
                serving(ByteOrder::Little, little),
                serving(ByteOrder::Big, big),
                discovery,
            ),
            udp: bind(interface, 0, "QTM's frames on UDP")?.0,
            address,
        })
    }

    /// Serves what has arrived; `clock` is the server's, in µs.
    pub(crate) fn serve(&mut self, clock: &impl Fn() -> u64, cameras: &CameraParameters) {
        match &mut self.protocol {
            Protocol::Vrpn(serving) => {
                call_back(&self.udp, serving);
                serving.serve(clock, cameras);
            }
            Protocol::Qtm(little, big, discovery) => {
                if let Some(discovery) = discovery {
                    answer_discovery(discovery, self.address.port());
                }
                little.serve(clock, cameras);
                big.serve(clock, cameras);
            }
        }
    }

    /// Sends a frame; returns the number of datagrams that were lost.
    pub(crate) fn frame(&mut self, cameras: &CameraParameters, frame: &CameraFrame) -> u64 {
        match &mut self.protocol {
            Protocol::Vrpn(serving) => serving.frame(cameras, frame, &self.udp),
            Protocol::Qtm(little, big, _) => {
                little.frame(cameras, frame, &self.udp) + big.frame(cameras, frame, &self.udp)
            }
        }
    }
}

/// VRPN's clients may send the address and port at which they wait for the server's call.
fn call_back(udp: &UdpSocket, serving: &mut Serving<VrpnServer>) {
    let mut buffer = [0; 256];
    // One at a time: a client that does not answer delays the others.
    if let Ok((length, from)) = udp.recv_from(&mut buffer) {
        let text = buffer.get(..length).map(String::from_utf8_lossy);
        let port = text.as_deref().and_then(|text| {
            let (_, port) = text.trim_end_matches('\0').split_once(' ')?;
            port.trim().parse().ok()
        });
        let Some(port) = port else {
            return;
        };
        // The address is that of the datagram, and not what it says.
        let to = SocketAddr::new(from.ip(), port);
        if let Ok(stream) = TcpStream::connect_timeout(&to, CALL_BACK) {
            serving.welcome(stream, from.ip(), true);
        }
    }
}

/// Answers who asks for QTM servers: the answer goes to the port in the question.
fn answer_discovery(socket: &UdpSocket, little_endian_port: u16) {
    let mut buffer = [0; 64];
    while let Ok((length, from)) = socket.recv_from(&mut buffer) {
        let question = buffer.get(..length).unwrap_or_default();
        let Some(port) = packet::discovery_port(question) else {
            continue;
        };
        let base_port = little_endian_port.saturating_sub(1);
        let answer = packet::discovered("singletrack-sim, QTM 2.17, 0 cameras", base_port);
        let _ = socket.send_to(&answer, SocketAddr::new(from.ip(), port));
    }
}

/// How long the server waits for a client that it calls back.
const CALL_BACK: core::time::Duration = core::time::Duration::from_millis(5);

fn listen(interface: Ipv4Addr, port: u16, purpose: &'static str) -> Bound<TcpListener> {
    let address = SocketAddrV4::new(interface, port);
    UdpError::or(address, purpose, || {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let bound = match listener.local_addr()? {
            SocketAddr::V4(bound) => bound,
            SocketAddr::V6(_) => address,
        };
        Ok((listener, bound))
    })
}
