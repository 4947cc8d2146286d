//! The TCP stream to the motion capture.

use std::{
    io::{self, Read as _, Write as _},
    net::TcpStream,
    os::fd::{AsFd as _, BorrowedFd},
};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use singletrack_core::cameras::StreamEvent;
use singletrack_mocap::{LocalEnd, Stream};
use socket2::{Domain, Protocol, Socket, Type};

/// Bytes that are read at a time.
const READ: usize = 65_536;

/// The stream that the session wants, as far as it is open.
#[derive(Debug)]
pub(crate) struct MocapStream {
    datagram_port: u16,
    /// What was wanted last: a stream that failed is not opened again.
    wanted: Option<Stream>,
    socket: Option<TcpStream>,
    is_open: bool,
    buffer: Vec<u8>,
}

impl MocapStream {
    /// No stream. Datagrams are received at this port.
    pub(crate) const fn new(datagram_port: u16) -> Self {
        Self {
            datagram_port,
            wanted: None,
            socket: None,
            is_open: false,
            buffer: Vec::new(),
        }
    }

    pub(crate) fn file(&self) -> Option<BorrowedFd<'_>> {
        let socket = self.socket.as_ref().filter(|_| self.is_open)?;
        Some(socket.as_fd())
    }

    pub(crate) const fn is_opening(&self) -> bool {
        self.socket.is_some() && !self.is_open
    }

    pub(crate) fn poll(&mut self, wanted: Option<Stream>, received: &mut Vec<u8>) -> StreamEvent {
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
    pub(crate) fn write(&self, bytes: &[u8]) {
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
