//! The sockets of a server that is reached over TCP, whatever its protocol.

use std::{
    io::{self, ErrorKind, Read as _, Write as _},
    net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4, TcpListener, TcpStream, UdpSocket},
};

use singletrack_mocap::qualisys::packet::{self, ByteOrder};

use crate::{
    cameras::{CameraFrame, CameraParameters, TICKS_PER_SECOND},
    qtm_server::QtmServer,
    udp::UdpError,
    vrpn_server::VrpnServer,
};

/// The client said what its protocol does not know.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refused;

/// What a protocol answers.
pub(crate) trait StreamServer: core::fmt::Debug {
    /// What is known of a client.
    type State: Default + core::fmt::Debug;

    /// What is said first.
    fn greeting(&self, client: &Client<Self::State>) -> Vec<u8>;

    /// Takes the first message of the client's input, and returns whether there was one.
    fn receive(
        &self,
        clock_us: u64,
        cameras: &CameraParameters,
        client: &mut Client<Self::State>,
    ) -> Result<bool, Refused>;

    /// The bytes of a frame for the client.
    fn frame(
        &self,
        cameras: &CameraParameters,
        frame: &CameraFrame,
        stamp_us: u64,
        client: &mut Client<Self::State>,
    ) -> Vec<u8>;
}

/// A client.
#[derive(Clone, Debug)]
pub(crate) struct Client<S> {
    pub(crate) state: S,
    pub(crate) address: IpAddr,
    /// The server called it back.
    pub(crate) was_called: bool,
    /// What was received, and how much of it was used.
    pub(crate) input: Vec<u8>,
    pub(crate) used: usize,
    /// What is to be sent on the stream.
    pub(crate) output: Vec<u8>,
    /// Where frames go, if not on the stream.
    pub(crate) datagrams_to: Option<SocketAddr>,
}

/// The most clients at a time, and the most bytes that wait for one.
const MAX_CLIENTS: usize = 16;
const MAX_WAITING: usize = 1 << 20;

/// A listening protocol with its clients.
#[derive(Debug)]
struct Serving<P: StreamServer> {
    protocol: P,
    listener: TcpListener,
    clients: Vec<(TcpStream, Client<P::State>)>,
}

impl<P: StreamServer> Serving<P> {
    fn new(protocol: P, listener: TcpListener) -> Self {
        Self {
            protocol,
            listener,
            clients: Vec::new(),
        }
    }

    fn welcome(&mut self, stream: TcpStream, address: IpAddr, was_called: bool) {
        let prepared = stream
            .set_nonblocking(true)
            .and_then(|()| stream.set_nodelay(true));
        if prepared.is_err() || self.clients.len() >= MAX_CLIENTS {
            return;
        }
        let mut client = Client {
            state: P::State::default(),
            address,
            was_called,
            input: Vec::new(),
            used: 0,
            output: Vec::new(),
            datagrams_to: None,
        };
        client.output = self.protocol.greeting(&client);
        self.clients.push((stream, client));
    }

    fn serve(&mut self, clock: &impl Fn() -> u64, cameras: &CameraParameters) {
        while let Ok((stream, from)) = self.listener.accept() {
            self.welcome(stream, from.ip(), false);
        }
        let protocol = &self.protocol;
        self.clients.retain_mut(|(stream, client)| {
            let is_alive = read(stream, &mut client.input)
                && loop {
                    match protocol.receive(clock(), cameras, client) {
                        Ok(true) => {}
                        Ok(false) => break true,
                        Err(Refused) => break false,
                    }
                };
            client.input.drain(..core::mem::take(&mut client.used));
            is_alive && write(stream, &mut client.output)
        });
    }

    /// Sends a frame; returns the number of datagrams that were lost.
    fn frame(&mut self, cameras: &CameraParameters, frame: &CameraFrame, udp: &UdpSocket) -> u64 {
        let stamp_us = frame.ticks.mid_exposure / (TICKS_PER_SECOND / 1_000_000);
        let protocol = &self.protocol;
        let mut lost = 0;
        self.clients.retain_mut(|(stream, client)| {
            let bytes = protocol.frame(cameras, frame, stamp_us, client);
            if bytes.is_empty() {
                return true;
            }
            match client.datagrams_to {
                Some(to) => {
                    lost += u64::from(udp.send_to(&bytes, to).is_err());
                    true
                }
                None => {
                    client.output.extend(bytes);
                    write(stream, &mut client.output)
                }
            }
        });
        lost
    }
}

/// Reads what has arrived; false if the client has gone.
fn read(mut stream: &TcpStream, input: &mut Vec<u8>) -> bool {
    let mut buffer = [0; 4_096];
    while input.len() < MAX_WAITING {
        match stream.read(&mut buffer) {
            Ok(0) => return false,
            Ok(length) => input.extend_from_slice(buffer.get(..length).unwrap_or_default()),
            Err(error) => return error.kind() == ErrorKind::WouldBlock,
        }
    }
    false
}

/// Writes what the client takes; false if it has gone, or does not read.
fn write(mut stream: &TcpStream, output: &mut Vec<u8>) -> bool {
    while !output.is_empty() {
        match stream.write(output) {
            Ok(length) => drop(output.drain(..length)),
            Err(error) => {
                return error.kind() == ErrorKind::WouldBlock && output.len() < MAX_WAITING;
            }
        }
    }
    true
}

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
    address: SocketAddrV4,
}

impl StreamServers {
    /// A VRPN server on TCP and UDP of this port.
    pub(crate) fn vrpn(interface: Ipv4Addr, port: u16) -> Result<Self, UdpError> {
        let (listener, address) = listen(interface, port, "VRPN")?;
        let udp = bind(address, "VRPN's requests on UDP")?;
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
            .then(|| SocketAddrV4::new(interface, port.saturating_add(3)))
            .and_then(|address| bind(address, "QTM's discovery").ok());
        let serving = |order, listener| Serving::new(QtmServer { order }, listener);
        Ok(Self {
            protocol: Protocol::Qtm(
                serving(ByteOrder::Little, little),
                serving(ByteOrder::Big, big),
                discovery,
            ),
            udp: bind(SocketAddrV4::new(interface, 0), "QTM's frames on UDP")?,
            address,
        })
    }

    pub(crate) const fn address(&self) -> SocketAddrV4 {
        self.address
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

fn listen(
    interface: Ipv4Addr,
    port: u16,
    purpose: &'static str,
) -> Result<(TcpListener, SocketAddrV4), UdpError> {
    let address = SocketAddrV4::new(interface, port);
    let open = || -> io::Result<(TcpListener, SocketAddrV4)> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let bound = match listener.local_addr()? {
            SocketAddr::V4(bound) => bound,
            SocketAddr::V6(_) => address,
        };
        Ok((listener, bound))
    };
    open().map_err(|source| UdpError {
        address,
        purpose,
        source,
    })
}

fn bind(address: SocketAddrV4, purpose: &'static str) -> Result<UdpSocket, UdpError> {
    let open = || -> io::Result<UdpSocket> {
        let socket = UdpSocket::bind(address)?;
        socket.set_nonblocking(true)?;
        Ok(socket)
    };
    open().map_err(|source| UdpError {
        address,
        purpose,
        source,
    })
}
