//! The control socket on TCP, for programs that know no Unix sockets: on loopback only, and
//! for those who know the token.
//!
//! Every user of this computer can connect to a port, and so can a web page in a browser on it.
//! The first line of a connection must therefore give the token. Nothing is read of a
//! connection after a wrong line, so that commands in the body of a request of HTTP, which
//! follow its own first line, are never seen.

use std::{
    io,
    net::{Ipv4Addr, SocketAddr, TcpListener},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use singletrack_access::{Token, TokenFile, WaitingRoom, linger};
use singletrack_api::{Answer, Code, SOCKET_VERSION};
use tokio::{
    io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::{sleep, timeout},
};

use super::{
    lines::send,
    stream::Connection,
    token::{is_given_by, token_path},
};

/// The largest number of connections at a time that have not given the token. They take no place
/// of a client who may connect, and a newer one takes the place of the oldest.
const STRANGERS: usize = 16;

/// The longest wait for the first line, and its longest length in bytes.
const FIRST_LINE_TIMEOUT: Duration = Duration::from_secs(2);
const LONGEST_FIRST_LINE: u64 = 256;

/// From a wrong token to its answer.
const REFUSAL_DELAY: Duration = Duration::from_millis(500);

/// A listening port, its token, and the file of the token.
#[derive(Debug)]
pub(super) struct BoundPort {
    pub(super) listener: TcpListener,
    pub(super) gate: Arc<Gate>,
    pub(super) file: TokenFile,
}

/// Lets those through who know the token.
#[derive(Debug)]
pub(super) struct Gate {
    token: Token,
    token_path: PathBuf,
    strangers: WaitingRoom,
}

impl BoundPort {
    /// Listens on `port` of 127.0.0.1, and writes the token beside the Unix socket `beside`.
    pub(super) fn bind(port: u16, beside: &Path) -> Result<Self, (&'static str, io::Error)> {
        let during = |action| move |error| (action, error);
        let listener =
            TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(during("listen on its port"))?;
        listener
            .set_nonblocking(true)
            .map_err(during("make it non-blocking"))?;
        let address = listener.local_addr().map_err(during("read its port"))?;
        let token = Token::random().map_err(during("make a token"))?;
        let token_path = token_path(beside);
        let file = TokenFile::create(token_path.clone(), address, &token)
            .map_err(during("write the file of the token"))?;
        tracing::info!(%address, token = %token_path.display(), "control socket on TCP");
        Ok(Self {
            listener,
            gate: Arc::new(Gate::new(token, token_path)),
            file,
        })
    }
}

impl Gate {
    fn new(token: Token, token_path: PathBuf) -> Self {
        Self {
            token,
            token_path,
            strangers: WaitingRoom::new(STRANGERS),
        }
    }

    /// The connection of a client that has given the token. Any other one is closed.
    pub(super) async fn pass(
        &self,
        stream: TcpStream,
        peer: SocketAddr,
    ) -> io::Result<Option<Connection>> {
        let mut place = self.strangers.enter();
        // An answer is one small write, which must not wait for the next one.
        stream.set_nodelay(true)?;
        let mut connection = Connection::from(stream);
        let Connection { read, write } = &mut connection;
        let mut line = Vec::new();
        let mut first = (&mut *read).take(LONGEST_FIRST_LINE);
        let first_line = timeout(FIRST_LINE_TIMEOUT, first.read_until(b'\n', &mut line));
        let Some(first_line) = place.until_lost(first_line).await else {
            return Ok(None);
        };
        let count = first_line.unwrap_or(Ok(0))?;
        if count > 0 && is_given_by(&self.token, &line) {
            send(write, &Answer::done()).await?;
            return Ok(Some(connection));
        }
        tracing::warn!(%peer, "a connection to the control socket on TCP without the token");
        if place.until_lost(sleep(REFUSAL_DELAY)).await.is_none() {
            return Ok(None);
        }
        let error = format!(
            "the first line must be {{\"version\":{SOCKET_VERSION},\"command\":\"token\",\
             \"token\":\"...\"}}, with the token from {}",
            self.token_path.display()
        );
        send(write, &Answer::failure(Code::Token, error)).await?;
        write.shutdown().await?;
        place.until_lost(linger(read)).await;
        Ok(None)
    }
}
