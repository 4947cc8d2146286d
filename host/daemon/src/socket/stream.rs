//! Lines of a client, and the two halves of its connection on either kind of socket.

use std::io;

use serde::Serialize;
use singletrack_api::{Answer, Code};
use socket2::SockRef;
use tokio::{
    io::{AsyncBufReadExt, AsyncWriteExt, BufReader},
    net::{TcpStream, UnixStream, tcp, unix},
    task::yield_now,
};
use tokio_util::either::Either;

/// The longest line, in bytes: a trajectory of 100 points with all their digits.
pub(super) const LONGEST_LINE: u64 = 16_384;

/// Reads and discards up to the end of the line or of the stream, and answers that it is too long.
pub(super) async fn refuse_long_line(
    read: &mut BufReader<ReadHalf>,
    write: &mut WriteHalf,
) -> io::Result<()> {
    loop {
        let bytes = read.fill_buf().await?;
        let end = bytes.iter().position(|&byte| byte == b'\n');
        let count = end.map_or(bytes.len(), |end| end + 1);
        read.consume(count);
        if end.is_some() || count == 0 {
            let error = format!("a line is at most {LONGEST_LINE} bytes long");
            return send(write, &Answer::failure(Code::Invalid, error)).await;
        }
        yield_now().await;
    }
}

pub(super) async fn send(write: &mut WriteHalf, answer: &impl Serialize) -> io::Result<()> {
    let mut line = serde_json::to_vec(answer)?;
    line.push(b'\n');
    write.write_all(&line).await
}

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
