//! The sockets to the motion capture; and the thread of the camera receiver, which waits for datagrams,
//! polls, and logs.

use std::{
    io::{self, Read as _, Write as _},
    net::{Ipv4Addr, SocketAddr, SocketAddrV4, TcpStream, UdpSocket},
    os::fd::{AsFd, BorrowedFd},
    thread::Thread,
    time::Duration,
};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use singletrack_core::{
    cameras::{CameraReceiver, Channel, Sockets, StreamEvent},
    config::{MotionCaptureSection, TransportKind},
};
use singletrack_mocap::{
    Binding, LocalEnd, SessionEvent, Stream,
    planar::{PlanarCounters, PlanarEvent},
};
use socket2::{Domain, Protocol, Socket, Type};
use tracing::{info, warn};

use crate::{
    clock::monotonic_ns,
    threads::{StopFlag, Woken},
};

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
            stream: MocapStream {
                datagram_port,
                ..MocapStream::default()
            },
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

/// Bytes that are read at a time.
const READ: usize = 65_536;

/// The stream that the session wants, as far as it is open.
#[derive(Debug, Default)]
struct MocapStream {
    /// Where datagrams are received.
    datagram_port: u16,
    /// What was wanted last: a stream that failed is not opened again.
    wanted: Option<Stream>,
    socket: Option<TcpStream>,
    is_open: bool,
    buffer: Vec<u8>,
}

impl MocapStream {
    fn file(&self) -> Option<BorrowedFd<'_>> {
        let socket = self.socket.as_ref().filter(|_| self.is_open)?;
        Some(socket.as_fd())
    }

    const fn is_opening(&self) -> bool {
        self.socket.is_some() && !self.is_open
    }

    fn poll(&mut self, wanted: Option<Stream>, received: &mut Vec<u8>) -> StreamEvent {
        if wanted != self.wanted {
            self.wanted = wanted;
            self.close();
            let Some(wanted) = wanted else {
                return StreamEvent::Nothing;
            };
            match connect(wanted) {
                Ok(socket) => self.socket = Some(socket),
                Err(_) => return StreamEvent::Closed,
            }
        }
        let Some(socket) = &self.socket else {
            return StreamEvent::Nothing;
        };
        let result = if self.is_open {
            self.buffer.resize(READ, 0);
            read(socket, &mut self.buffer, received)
        } else {
            opened(socket, self.datagram_port)
        };
        match result {
            Ok(StreamEvent::Opened(local)) => {
                self.is_open = true;
                StreamEvent::Opened(local)
            }
            Ok(event) => event,
            Err(_) => {
                self.close();
                StreamEvent::Closed
            }
        }
    }

    /// A stream that does not take the few bytes of a request at once is shut down, which the
    /// next poll finds.
    fn write(&self, bytes: &[u8]) {
        if let Some(mut socket) = self.socket.as_ref().filter(|_| self.is_open)
            && socket.write_all(bytes).is_err()
        {
            let _ = socket.shutdown(std::net::Shutdown::Both);
        }
    }

    fn close(&mut self) {
        self.socket = None;
        self.is_open = false;
    }
}

fn connect(wanted: Stream) -> io::Result<TcpStream> {
    let socket = Socket::new(
        Domain::for_address(wanted.server),
        Type::STREAM,
        Some(Protocol::TCP),
    )?;
    socket.set_nonblocking(true)?;
    socket.set_tcp_nodelay(true)?;
    match socket.connect(&wanted.server.into()) {
        Err(error)
            if error.raw_os_error() != Some(rustix::io::Errno::INPROGRESS.raw_os_error()) =>
        {
            Err(error)
        }
        _ => Ok(socket.into()),
    }
}

fn opened(socket: &TcpStream, datagram_port: u16) -> io::Result<StreamEvent> {
    let mut polled = [PollFd::new(socket, PollFlags::OUT)];
    if poll(&mut polled, Some(&Timespec::default()))? == 0 {
        return Ok(StreamEvent::Nothing);
    }
    if let Some(error) = socket.take_error()? {
        return Err(error);
    }
    socket.peer_addr()?;
    Ok(StreamEvent::Opened(LocalEnd {
        address: socket.local_addr()?.ip(),
        datagram_port,
    }))
}

fn read(
    mut socket: &TcpStream,
    buffer: &mut [u8],
    received: &mut Vec<u8>,
) -> io::Result<StreamEvent> {
    match socket.read(buffer) {
        Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
        Ok(length) => {
            received.extend_from_slice(buffer.get(..length).unwrap_or_default());
            Ok(StreamEvent::Received)
        }
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(StreamEvent::Nothing),
        Err(error) => Err(error),
    }
}

/// Lines that the cameras may write to the log in a span of time: a server that is out of order
/// must not fill it.
const LINES: u32 = 20;
const SPAN_NS: u64 = 10_000_000_000;

/// What is left of them.
#[derive(Debug, Default)]
struct LogBudget {
    since_ns: u64,
    lines: u32,
}

impl LogBudget {
    /// Whether a line may be written; the last one says that no other follows.
    fn allows(&mut self, now_ns: u64) -> bool {
        if now_ns.saturating_sub(self.since_ns) >= SPAN_NS {
            (self.since_ns, self.lines) = (now_ns, 0);
        }
        self.lines = self.lines.saturating_add(1);
        if self.lines == LINES {
            warn!("motion capture: more of this is not logged for some seconds");
        }
        self.lines < LINES
    }
}

/// How often a stream that is being opened is looked at.
const OPENING: Duration = Duration::from_millis(5);

/// Runs until `stop` is raised, and wakes `control` for every observation. Returns the counters,
/// and the number of observations that found no room in the ring to the control loop.
pub(crate) fn run(
    mut receiver: CameraReceiver,
    mut sockets: MocapSockets,
    config: &MotionCaptureSection,
    stop: &StopFlag,
    control: &Thread,
) -> (PlanarCounters, u64) {
    let mut budget = LogBudget::default();
    let mut passed = 0;
    loop {
        let until_ns = receiver.poll(&monotonic_ns, &mut sockets, &mut |event| {
            if budget.allows(monotonic_ns()) {
                log(event, config);
            }
        });
        if receiver.passed != passed {
            passed = receiver.passed;
            control.unpark();
        }
        let mut wait = Duration::from_nanos(until_ns.saturating_sub(monotonic_ns()));
        if sockets.is_opening() {
            wait = wait.min(OPENING);
        }
        if stop.wait(&sockets.files(), wait) == Woken::Stop {
            receiver.close(&monotonic_ns, &mut sockets);
            return (receiver.counters(), receiver.dropped);
        }
    }
}

fn log(event: &PlanarEvent, config: &MotionCaptureSection) {
    let name = config.rigid_body.as_str();
    match event {
        PlanarEvent::Session(SessionEvent::Connected(connected)) => {
            info!(
                bitstream = %connected.version,
                camera_clock = connected.has_camera_clock,
                "motion capture connected"
            );
        }
        PlanarEvent::Session(SessionEvent::Opened) => info!("motion capture connected"),
        PlanarEvent::Session(SessionEvent::Foreign) => warn!(
            server = %config.server, port = config.port(), kind = config.kind.name(),
            "what answers speaks another protocol or an unsupported version of it: look at \
             motion_capture.kind and command_port"
        ),
        PlanarEvent::Session(SessionEvent::DatagramsBlocked) => warn!(
            "poses come over TCP, because none arrive over UDP: open UDP from the server in this \
             computer's firewall, or set motion_capture.transport = \"tcp\""
        ),
        PlanarEvent::Session(SessionEvent::Refused(version)) => warn!("motion capture: {version}"),
        PlanarEvent::Session(SessionEvent::BitstreamKept { requested, kept }) => warn!(
            %requested, %kept,
            "motion_capture.server keeps its own bitstream, which is decoded instead"
        ),
        PlanarEvent::Session(SessionEvent::TransportMismatch { server_multicast }) => warn!(
            server_multicast,
            "motion_capture.transport differs from the server's: frames may not arrive"
        ),
        PlanarEvent::Binding(Binding::Bound { id }) => info!(name, id, "rigid body found"),
        // The diagnosis names the server's bodies.
        PlanarEvent::Binding(Binding::Missing | Binding::Ambiguous { .. }) => {}
        PlanarEvent::Session(SessionEvent::OtherSource(address)) => warn!(
            %address, server = %config.server,
            "packets from another address than motion_capture.server are ignored"
        ),
        PlanarEvent::Session(SessionEvent::DefinitionsUnreadable(error)) => warn!(
            %error,
            "a part of the server's list of bodies can't be read; the others are known"
        ),
        PlanarEvent::Session(SessionEvent::Contradicted) => warn!(
            server = %config.server,
            "frames contradict each other: another program sends with the server's address"
        ),
        PlanarEvent::Binding(Binding::Unresolved) => {
            info!(name, "the server's rigid bodies are requested again");
        }
        PlanarEvent::Session(SessionEvent::Stale) => {
            warn!("frames of the motion capture have stopped");
        }
        PlanarEvent::Session(SessionEvent::Restarted(reason)) => {
            warn!(?reason, "motion capture reconnects");
        }
        event => info!(?event, "motion capture"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_that_is_out_of_order_writes_few_lines_and_is_heard_again_later() {
        let mut budget = LogBudget::default();
        let lines =
            |budget: &mut LogBudget, now_ns| (0..1_000).filter(|_| budget.allows(now_ns)).count();
        assert_eq!(lines(&mut budget, SPAN_NS), 19);
        assert_eq!(lines(&mut budget, 2 * SPAN_NS - 1), 0);
        assert_eq!(lines(&mut budget, 2 * SPAN_NS), 19);
    }
}
