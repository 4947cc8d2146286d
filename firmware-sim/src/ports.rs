//! What hosts in other processes reach: a pseudo-terminal in place of the board's serial port, and the
//! sockets of the cameras' servers: their addresses, the datagrams of NatNet, and the clients of a
//! server that is reached over TCP, whatever its protocol.

use std::{
    ffi::OsStr,
    io::{self, ErrorKind, Read as _, Write as _},
    net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4, TcpListener, TcpStream, UdpSocket},
    os::{fd::OwnedFd, unix::ffi::OsStrExt},
    path::{Path, PathBuf},
};

use rustix::{
    fs::{OFlags, fcntl_setfl},
    io::Errno,
    pty::{OpenptFlags, grantpt, ioctl_tiocgptpeer, openpt, ptsname, unlockpt},
    termios::{OptionalActions, ioctl_tiocnxcl, tcgetattr, tcsetattr},
};
use socket2::{Domain, Protocol, Socket, Type};

use crate::{
    cameras::{CameraFrame, CameraParameters, TICKS_PER_SECOND},
    natnet_server::{Datagram, Destination},
};

/// Why there is no pseudo-terminal, or no link to it.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct PtyError(String);

/// A pseudo-terminal in place of the board's serial port. Dropping it hangs up.
///
/// All byte values pass unchanged. It keeps the host's end open, because its own
/// end would otherwise return errors while no host is connected.
#[derive(Debug)]
pub struct Pty {
    master: OwnedFd,
    host_end: OwnedFd,
    device: PathBuf,
    link: Option<PathBuf>,
}

impl Pty {
    /// Opens a pseudo-terminal and links `link` to its device, replacing an existing
    /// link.
    ///
    /// # Errors
    ///
    /// Fails if the system provides none, or the link can't be created.
    pub fn open(link: Option<&Path>) -> Result<Self, PtyError> {
        let (master, host_end, device) = open_raw().map_err(|error| {
            let error = io::Error::from(error);
            PtyError(format!("can't open a pseudo-terminal: {error}"))
        })?;
        if let Some(link) = link {
            replace_link(link, &device).map_err(|error| {
                let link = link.display();
                PtyError(format!("can't link {link} to the pseudo-terminal: {error}"))
            })?;
        }
        Ok(Self {
            master,
            host_end,
            device,
            link: link.map(Path::to_owned),
        })
    }

    /// Path for the host: the link if there is one, else the device.
    pub fn path(&self) -> &Path {
        self.link.as_deref().unwrap_or(&self.device)
    }

    /// Reads bytes from the host; zero if there are none.
    ///
    /// # Errors
    ///
    /// The system's error.
    pub fn read(&self, buffer: &mut [u8]) -> io::Result<usize> {
        now(rustix::io::read(&self.master, buffer))
    }

    /// Writes bytes to the host; returns the number written.
    ///
    /// # Errors
    ///
    /// The system's error.
    pub fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        now(rustix::io::write(&self.master, bytes))
    }

    /// Clears exclusive mode. A real port loses it when it is closed, but this one
    /// is never closed.
    pub fn clear_exclusive(&self) {
        // If this fails, the next host reports the error.
        let _ = ioctl_tiocnxcl(&self.host_end);
    }
}

/// What was done without waiting.
fn now(done: rustix::io::Result<usize>) -> io::Result<usize> {
    match done {
        Err(Errno::AGAIN | Errno::INTR) => Ok(0),
        done => Ok(done?),
    }
}

impl Drop for Pty {
    fn drop(&mut self) {
        if let Some(link) = &self.link
            && std::fs::read_link(link).is_ok_and(|target| target == self.device)
        {
            // No one can handle an error here.
            let _ = std::fs::remove_file(link);
        }
    }
}

fn open_raw() -> rustix::io::Result<(OwnedFd, OwnedFd, PathBuf)> {
    let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
    let master = openpt(flags)?;
    grantpt(&master)?;
    unlockpt(&master)?;
    let device = ptsname(&master, Vec::new())?;
    let host_end = ioctl_tiocgptpeer(&master, flags)?;
    let mut settings = tcgetattr(&host_end)?;
    settings.make_raw();
    tcsetattr(&host_end, OptionalActions::Now, &settings)?;
    fcntl_setfl(&master, OFlags::NONBLOCK)?;
    let device = PathBuf::from(OsStr::from_bytes(device.as_bytes()));
    Ok((master, host_end, device))
}

fn replace_link(link: &Path, device: &Path) -> io::Result<()> {
    if std::fs::symlink_metadata(link).is_ok_and(|metadata| !metadata.is_symlink()) {
        return Err(io::Error::other(
            "the path exists and is not a link; remove it or choose another path",
        ));
    }
    // Created beside and renamed, so that the link always exists.
    let mut temporary = link.as_os_str().to_owned();
    temporary.push(format!(".{}", std::process::id()));
    let temporary = PathBuf::from(temporary);
    std::os::unix::fs::symlink(device, &temporary)?;
    std::fs::rename(&temporary, link).inspect_err(|_| {
        // The first error is the one to report.
        let _ = std::fs::remove_file(&temporary);
    })
}

/// Addresses of the cameras' server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
#[error("{0}")]
pub struct UdpError(String);

impl UdpError {
    /// What `open` returns, or this error for its error.
    pub(crate) fn or<T>(
        address: SocketAddrV4,
        purpose: &str,
        open: impl FnOnce() -> io::Result<T>,
    ) -> Result<T, Self> {
        open().map_err(|error| {
            Self(format!(
                "can't serve the cameras on {address} ({purpose}): {error}; choose another port, or 0 \
                 for a free one"
            ))
        })
    }
}

/// The NatNet server's sockets.
#[derive(Debug)]
pub(crate) struct NatNetSockets {
    command: UdpSocket,
    data: UdpSocket,
    pub(crate) command_address: SocketAddrV4,
    pub(crate) data_address: SocketAddrV4,
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

    /// The next received datagram.
    pub(crate) fn receive(&self, buffer: &mut [u8]) -> Option<(usize, SocketAddr)> {
        loop {
            match self.command.recv_from(buffer) {
                Ok(received) => return Some(received),
                // A client has gone: an ICMP error for an earlier frame.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
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
        let socket = match (datagram.from, &self.second) {
            (Some(_), Some(second)) => second,
            _ if datagram.is_frame => &self.data,
            _ => &self.command,
        };
        socket.send_to(&datagram.bytes, to).is_ok()
    }
}

/// A socket and its address.
pub(crate) type Bound<S> = Result<(S, SocketAddrV4), UdpError>;

/// A UDP socket that does not wait.
pub(crate) fn bind(interface: Ipv4Addr, port: u16, purpose: &'static str) -> Bound<UdpSocket> {
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

/// The client said what its protocol does not know.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refused;

/// What a protocol answers.
pub(crate) trait StreamServer: core::fmt::Debug {
    /// What is known of a client.
    type State: Default + core::fmt::Debug;

    /// What is said first.
    fn greeting(&self, client: &Client<Self::State>) -> Vec<u8>;

    /// Takes the first message of the input, and returns its length; none if it is not complete.
    fn receive(
        &self,
        clock_us: u64,
        cameras: &CameraParameters,
        client: &mut Client<Self::State>,
        input: &[u8],
    ) -> Result<Option<usize>, Refused>;

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
pub(crate) struct Serving<P: StreamServer> {
    protocol: P,
    listener: TcpListener,
    /// With what was received of each and not used.
    clients: Vec<(TcpStream, Client<P::State>, Vec<u8>)>,
}

impl<P: StreamServer> Serving<P> {
    pub(crate) fn new(protocol: P, listener: TcpListener) -> Self {
        Self {
            protocol,
            listener,
            clients: Vec::new(),
        }
    }

    pub(crate) fn welcome(&mut self, stream: TcpStream, address: IpAddr, was_called: bool) {
        let prepared = stream.set_nonblocking(true);
        let prepared = prepared.and_then(|()| stream.set_nodelay(true));
        if prepared.is_err() || self.clients.len() >= MAX_CLIENTS {
            return;
        }
        let mut client = Client {
            state: P::State::default(),
            address,
            was_called,
            output: Vec::new(),
            datagrams_to: None,
        };
        client.output = self.protocol.greeting(&client);
        self.clients.push((stream, client, Vec::new()));
    }

    pub(crate) fn serve(&mut self, clock: &impl Fn() -> u64, cameras: &CameraParameters) {
        while let Ok((stream, from)) = self.listener.accept() {
            self.welcome(stream, from.ip(), false);
        }
        let protocol = &self.protocol;
        self.clients.retain_mut(|(stream, client, input)| {
            let mut used = 0;
            let is_alive = read(stream, input)
                && loop {
                    let unused = input.get(used..).unwrap_or_default();
                    match protocol.receive(clock(), cameras, client, unused) {
                        Ok(Some(length)) => used += length,
                        Ok(None) => break true,
                        Err(Refused) => break false,
                    }
                };
            input.drain(..used);
            is_alive && write(stream, &mut client.output)
        });
    }

    /// Sends a frame; returns the number of datagrams that were lost.
    pub(crate) fn frame(
        &mut self,
        cameras: &CameraParameters,
        frame: &CameraFrame,
        udp: &UdpSocket,
    ) -> u64 {
        let stamp_us = frame.ticks.mid_exposure / (TICKS_PER_SECOND / 1_000_000);
        let protocol = &self.protocol;
        let mut lost = 0;
        self.clients.retain_mut(|(stream, client, _)| {
            let bytes = protocol.frame(cameras, frame, stamp_us, client);
            if bytes.is_empty() {
                return true;
            }
            if let Some(to) = client.datagrams_to {
                lost += u64::from(udp.send_to(&bytes, to).is_err());
                return true;
            }
            client.output.extend(bytes);
            write(stream, &mut client.output)
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
            Err(error) if error.kind() != ErrorKind::WouldBlock => return false,
            Err(_) => return output.len() < MAX_WAITING,
        }
    }
    true
}
