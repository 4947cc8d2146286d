//! A client's connection: over the Unix socket or TCP. Everything behind it is the same.

use std::io;

use socket2::SockRef;
use tokio::{
    io::BufReader,
    net::{TcpStream, UnixStream, tcp, unix},
};
use tokio_util::either::Either;

pub(super) type ReadHalf = Either<unix::OwnedReadHalf, tcp::OwnedReadHalf>;
pub(super) type WriteHalf = Either<unix::OwnedWriteHalf, tcp::OwnedWriteHalf>;

/// Both directions of a connection.
#[derive(Debug)]
pub(super) struct Connection {
    pub(super) read: BufReader<ReadHalf>,
    pub(super) write: WriteHalf,
}

impl From<UnixStream> for Connection {
    fn from(stream: UnixStream) -> Self {
        let (read, write) = stream.into_split();
        Self {
            read: BufReader::new(Either::Left(read)),
            write: Either::Left(write),
        }
    }
}

impl From<TcpStream> for Connection {
    fn from(stream: TcpStream) -> Self {
        let (read, write) = stream.into_split();
        Self {
            read: BufReader::new(Either::Right(read)),
            write: Either::Right(write),
        }
    }
}

/// Limits what the kernel keeps for a client that is slow to read.
pub(super) fn limit_send_buffer(write: &WriteHalf, bytes: usize) -> io::Result<()> {
    match write {
        Either::Left(unix) => SockRef::from(unix.as_ref()).set_send_buffer_size(bytes),
        Either::Right(tcp) => SockRef::from(tcp.as_ref()).set_send_buffer_size(bytes),
    }
}
