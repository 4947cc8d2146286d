//! Lines to the daemon, and its answers.

use std::{
    io::{self, Read as _, Write as _},
    net::Shutdown,
    os::{
        fd::{AsFd, BorrowedFd, OwnedFd},
        unix::net::UnixStream,
    },
    path::Path,
    time::Duration,
};

use serde::de::DeserializeOwned;
use socket2::{Domain, SockAddr, Socket, Type};

use crate::{Answer, ClientError, Request};

/// The longest wait for a daemon that accepts no connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// The longest wait for an answer: a reference with a governor takes seconds to judge, and more with
/// `[tuning]` on a slow computer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(120);

/// Connects to the daemon that listens at `path`.
///
/// # Errors
///
/// No process listens there, or it accepts nothing.
pub fn connect(path: &Path) -> Result<UnixStream, ClientError> {
    let connected = || {
        let socket = Socket::new(Domain::UNIX, Type::STREAM, None)?;
        // It bounds the wait for a place in the listener's queue, too.
        socket.set_write_timeout(Some(CONNECT_TIMEOUT))?;
        socket.connect(&SockAddr::unix(path)?)?;
        Ok(UnixStream::from(OwnedFd::from(socket)))
    };
    connected().map_err(|source: io::Error| match source.kind() {
        io::ErrorKind::WouldBlock => ClientError::silent(path, CONNECT_TIMEOUT),
        _ => ClientError::Connect {
            path: path.to_owned(),
            source,
        },
    })
}

/// The daemon's answer to one request, unless it is a refusal.
///
/// # Errors
///
/// The daemon can't be asked, or refuses; the reason is the daemon's.
pub fn ask(request: &Request, path: &Path) -> Result<Answer, ClientError> {
    ask_within(request, path, ANSWER_TIMEOUT)
}

/// [`ask`] with another longest wait for the answer.
///
/// # Errors
///
/// Those of [`ask`].
pub fn ask_within(
    request: &Request,
    path: &Path,
    patience: Duration,
) -> Result<Answer, ClientError> {
    ask_as::<Answer>(request, path, patience)?.agreed()
}

/// The daemon's answer to one request as another type, such as one with the keys that this client
/// does not know; also if it is a refusal.
///
/// # Errors
///
/// The daemon can't be asked.
pub fn ask_as<T: DeserializeOwned>(
    request: &Request,
    path: &Path,
    patience: Duration,
) -> Result<T, ClientError> {
    let mut connection = Connection::open(path, patience.min(CONNECT_TIMEOUT))?;
    connection.send(request)?;
    let answer = connection.receive_within(patience)?;
    answer.ok_or_else(|| ClientError::silent(path, patience))
}

/// A connection for lines in both directions.
#[derive(Debug)]
pub struct Connection {
    stream: UnixStream,
    /// What was read and is not yet taken.
    received: Vec<u8>,
    /// The longest wait for something to read.
    wait: Option<Duration>,
}

impl Connection {
    /// Connects to `path`. `patience` is the longest time that [`send`](Self::send) waits for a
    /// daemon that does not read.
    ///
    /// # Errors
    ///
    /// No process listens there.
    pub fn open(path: &Path, patience: Duration) -> Result<Self, ClientError> {
        let stream = connect(path)?;
        stream.set_write_timeout(Some(patience))?;
        Ok(Self {
            stream,
            received: Vec::new(),
            wait: None,
        })
    }

    /// Connects to `path` and subscribes to the state of every tick; the daemon's answer is the first
    /// line. `patience` is as for [`open`](Self::open).
    ///
    /// # Errors
    ///
    /// No process listens there, or the daemon does not read.
    pub fn watch_states(path: &Path, patience: Duration) -> Result<Self, ClientError> {
        let mut states = Self::open(path, patience)?;
        let topics = vec!["state".to_owned()];
        states.send(&Request::Watch { topics })?;
        Ok(states)
    }

    /// A second handle of a connection from which nothing was received yet: to read with one, and to
    /// send with the other.
    ///
    /// # Errors
    ///
    /// The system has no more files.
    pub fn try_clone(&self) -> Result<Self, ClientError> {
        Ok(Self {
            stream: self.stream.try_clone()?,
            received: Vec::new(),
            wait: None,
        })
    }

    /// Ends the connection for all of its handles: the daemon and who receives see that it has ended.
    pub fn hang_up(&self) {
        // It fails for one that has ended.
        let _ = self.stream.shutdown(Shutdown::Both);
    }

    /// Says that no more requests come. The daemon then sends its last answers, and closes the
    /// connection.
    ///
    /// # Errors
    ///
    /// The connection is lost.
    pub fn end_requests(&self) -> Result<(), ClientError> {
        Ok(self.stream.shutdown(Shutdown::Write)?)
    }

    /// Sends a request.
    ///
    /// # Errors
    ///
    /// The connection is lost, or the daemon does not read.
    pub fn send(&mut self, request: &Request) -> Result<(), ClientError> {
        self.stream.set_nonblocking(false)?;
        Ok(self.stream.write_all(request.to_line()?.as_bytes())?)
    }

    /// The next line, if it has arrived.
    ///
    /// # Errors
    ///
    /// The connection is lost, or the line is no `T`.
    pub fn receive<T: DeserializeOwned>(&mut self) -> Result<Option<T>, ClientError> {
        self.stream.set_nonblocking(true)?;
        self.read_line()
    }

    /// Waits for the next line; `None` if nothing comes within `wait`.
    ///
    /// # Errors
    ///
    /// The connection is lost, or the line is no `T`.
    pub fn receive_within<T: DeserializeOwned>(
        &mut self,
        wait: Duration,
    ) -> Result<Option<T>, ClientError> {
        self.stream.set_nonblocking(false)?;
        if self.wait != Some(wait) {
            self.stream.set_read_timeout(Some(wait))?;
            self.wait = Some(wait);
        }
        self.read_line()
    }

    fn read_line<T: DeserializeOwned>(&mut self) -> Result<Option<T>, ClientError> {
        loop {
            if let Some(end) = self.received.iter().position(|&byte| byte == b'\n') {
                let line: Vec<u8> = self.received.drain(..=end).collect();
                return Ok(Some(serde_json::from_slice(&line)?));
            }
            let mut buffer = [0; 16_384];
            match self.stream.read(&mut buffer) {
                Ok(0) => return Err(ClientError::Ended),
                Ok(count) => self.received.extend(buffer.iter().take(count)),
                Err(error) => match error.kind() {
                    io::ErrorKind::Interrupted => {}
                    io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => return Ok(None),
                    _ => return Err(error.into()),
                },
            }
        }
    }
}

impl AsFd for Connection {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.stream.as_fd()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use std::{io::Write as _, os::unix::net::UnixListener, thread};

    use serde_json::{Value, json};

    use super::*;

    #[test]
    fn a_line_that_comes_in_two_parts_is_received_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let listener = UnixListener::bind(&path).unwrap();
        let mut connection = Connection::open(&path, Duration::from_secs(1)).unwrap();
        let (mut daemon, _) = listener.accept().unwrap();
        daemon.write_all(b"{\"ok\":").unwrap();
        assert_eq!(connection.receive::<Value>().unwrap(), None);
        let short = Duration::from_millis(1);
        assert_eq!(connection.receive_within::<Value>(short).unwrap(), None);
        daemon.write_all(b"true}\n{}\n").unwrap();
        assert_eq!(connection.receive().unwrap(), Some(json!({ "ok": true })));
        assert_eq!(connection.receive().unwrap(), Some(json!({})));
        drop(daemon);
        assert!(matches!(
            connection.receive::<Value>(),
            Err(ClientError::Ended)
        ));
    }

    #[test]
    fn a_refusal_is_an_error_with_the_daemons_words() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let listener = UnixListener::bind(&path).unwrap();
        let daemon = thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream
                .write_all(b"{\"ok\":false,\"error\":\"the car is gone\",\"version\":3}\n")
                .unwrap();
            stream
        });
        let error = ask(&Request::DISARM, &path).unwrap_err();
        assert_eq!(error.to_string(), "the car is gone");
        drop(daemon.join().unwrap());
    }

    #[test]
    fn a_daemon_that_accepts_or_answers_nothing_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("socket");
        let _stopped = UnixListener::bind(&path).unwrap();
        let error = ask_within(&Request::DISARM, &path, Duration::from_millis(20)).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("no answer") && error.contains("socket"),
            "{error}"
        );
    }

    #[test]
    fn a_socket_without_a_daemon_is_named() {
        let error = connect(Path::new("/nonexistent/socket")).unwrap_err();
        assert!(error.to_string().contains("/nonexistent/socket"));
    }
}
