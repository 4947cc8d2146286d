//! Lines to the daemon, and its answers; the offset of its clock, and drives that a connection holds.

use std::{
    io::{self, Read as _, Write as _},
    net::Shutdown,
    os::{
        fd::{AsFd, BorrowedFd, OwnedFd},
        unix::net::UnixStream,
    },
    path::Path,
    time::{Duration, Instant},
};

use serde::de::DeserializeOwned;
use socket2::{Domain, SockAddr, Socket, Type};

use crate::{Answer, Arm, Attendance, ClientError, Reply, Request};

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

    /// Sends a request, and waits for its answer.
    pub(crate) fn exchange(
        &mut self,
        request: &Request,
        patience: Duration,
    ) -> Result<Answer, ClientError> {
        self.send(request)?;
        let reply = self.receive_within::<Reply>(patience)?;
        reply.ok_or(ClientError::Ended)?.agreed()
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

/// The number of exchanges, of which the fastest counts.
const EXCHANGES: usize = 8;

/// How far a daemon's `CLOCK_MONOTONIC` is ahead of a client's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockOffset {
    /// The daemon's time less the client's, in ns.
    pub offset_ns: i64,
    /// The largest error of the offset: half the round trip, in ns.
    pub bound_ns: u64,
}

impl ClockOffset {
    /// The daemon's time at `client_ns` of the client's.
    pub const fn daemon_ns(&self, client_ns: u64) -> u64 {
        client_ns.saturating_add_signed(self.offset_ns)
    }

    /// Offset by one exchange: asked at `sent_ns` and answered at `received_ns` of the client's clock,
    /// with `daemon_ns` between.
    const fn of(sent_ns: u64, daemon_ns: u64, received_ns: u64) -> Self {
        let bound_ns = received_ns.saturating_sub(sent_ns).div_ceil(2);
        Self {
            // Two clocks that count from the start of a computer differ by less than 292 years.
            offset_ns: daemon_ns
                .wrapping_sub(sent_ns.saturating_add(bound_ns))
                .cast_signed(),
            bound_ns,
        }
    }
}

impl Connection {
    /// Measures how far the daemon's clock is ahead of `clock`. Each exchange waits for `patience`
    /// at most.
    ///
    /// # Errors
    ///
    /// The connection is lost, or the daemon does not answer with its clock.
    pub fn clock_offset(
        &mut self,
        clock: impl Fn() -> u64,
        patience: Duration,
    ) -> Result<ClockOffset, ClientError> {
        let mut exchange = || -> Result<ClockOffset, ClientError> {
            let sent_ns = clock();
            let answer = self.exchange(&Request::Clock {}, patience)?;
            let received_ns = clock();
            let clocks = answer.clocks.ok_or(ClientError::Ended)?;
            Ok(ClockOffset::of(sent_ns, clocks.monotonic_ns, received_ns))
        };
        let mut best = exchange()?;
        for _ in 1..EXCHANGES {
            let next = exchange()?;
            if next.bound_ns < best.bound_ns {
                best = next;
            }
        }
        Ok(best)
    }
}

/// Interval of the renewals. The daemon stops the car 0.5 s after the last one.
pub const RENEWAL: Duration = Duration::from_millis(100);

/// A connection that holds a drive, for as long as its owner calls it. Dropped, it ends the drive.
#[derive(Debug)]
pub struct HeldDrive {
    /// Its connection, for other requests and what the daemon says of the drive.
    pub connection: Connection,
    interval: Duration,
    renewed: Instant,
}

impl HeldDrive {
    /// Holds what `connection` arms, or has armed, with a renewal every `interval`.
    pub fn new(connection: Connection, interval: Duration) -> Self {
        Self {
            connection,
            interval,
            renewed: Instant::now(),
        }
    }

    /// Arms, and returns once the car drives. `patience` is the longest wait for a daemon that does
    /// not read.
    ///
    /// # Errors
    ///
    /// The daemon refuses, or the connection is lost.
    pub fn arm(socket: &Path, patience: Duration, wait: Duration) -> Result<Self, ClientError> {
        let mut drive = Self::new(Connection::open(socket, patience)?, RENEWAL);
        drive.connection.send(&Request::Arm(Arm {
            attendance: Some(Attendance::Hold),
            ..Arm::default()
        }))?;
        loop {
            if let Some(reply) = drive.next(wait)? {
                reply.agreed()?;
                return Ok(drive);
            }
        }
    }

    /// Whether a renewal is due; then the next one is due an interval later.
    pub fn is_due(&mut self) -> bool {
        let is_due = self.renewed.elapsed() >= self.interval;
        if is_due {
            self.renewed = Instant::now();
        }
        is_due
    }

    /// Renews the drive if that is due.
    ///
    /// # Errors
    ///
    /// The connection is lost.
    pub fn renew(&mut self) -> Result<(), ClientError> {
        match self.is_due() {
            true => self.connection.send(&Request::Hold {}),
            false => Ok(()),
        }
    }

    /// Renews the drive if that is due, and waits for the daemon's next line; `None` if none comes
    /// within `wait`, which must be shorter than the interval.
    ///
    /// # Errors
    ///
    /// The connection is lost.
    pub fn next(&mut self, wait: Duration) -> Result<Option<Reply>, ClientError> {
        self.renew()?;
        self.connection.receive_within(wait)
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

    #[test]
    fn the_offset_is_within_its_bound_wherever_the_daemon_read_its_clock() {
        for ahead in [0, 3_000_000_000, -5_000] {
            for read_ns in [10_000, 12_345, 20_001] {
                let daemon_ns = u64::saturating_add_signed(read_ns, ahead);
                let ClockOffset {
                    offset_ns,
                    bound_ns,
                } = ClockOffset::of(10_000, daemon_ns, 20_001);
                assert!(offset_ns.abs_diff(ahead) <= bound_ns, "{ahead} {read_ns}");
            }
        }
    }
}
