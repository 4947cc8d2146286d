//! The session of one client with one server: its state, and what it sends by itself and when.
//!
//! How a session reaches a server and what it makes of datagrams is in [`receive`].

mod receive;

use crate::{
    clock::{CaptureClock, EchoClock},
    codec::{BitstreamVersion, ClientMessage, Connect, Connection, DecodeError},
    config::{SessionConfig, SessionConfigError, Transport},
    consistency::{Consistency, Sequence},
    encode,
    pose_source::{Common, Input, Output, Phase, PoseSource, RestartReason, Transmit, Wake},
};

/// The name that the client introduces itself with.
const CLIENT_NAME: &str = "Singletrack";

/// The first exchanges follow each other quickly, so that the clock is soon known.
const QUICK_ECHOES: usize = 8;
const QUICK_ECHO_NS: u64 = 100_000_000;

/// How often the bitstream is requested before the session takes the server's own.
const BITSTREAM_ATTEMPTS: u32 = 5;

/// Until the definitions have been read they are requested at this interval; while
/// a body that is needed is not in them, at the longer one.
const UNREAD_MODELS_NS: u64 = 100_000_000;
const INCOMPLETE_MODELS_NS: u64 = 500_000_000;

/// A NatNet client without socket and clock: it follows all rigid bodies of one
/// server.
///
/// [The crate's documentation](crate) describes how to call it. Create one with
/// [`new`](Self::new); the first [`poll_transmit`](PoseSource::poll_transmit) begins the
/// handshake.
///
/// ```
/// use singletrack_mocap::{Input, PoseSource, Session, SessionConfig, Transport, UpAxis};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let server = "192.168.1.10".parse()?;
/// let transport = Transport::Unicast { bitstream: None };
/// let mut session = Session::new(SessionConfig::new(server, transport, UpAxis::Y))?;
///
/// // The first message is CONNECT, to the server's command port.
/// let connect = session.poll_transmit(0).expect("CONNECT is due at once");
/// assert_eq!(connect.destination, "192.168.1.10:1510".parse()?);
///
/// // Without an answer it is due again half a second later.
/// assert_eq!(session.poll_transmit(0), None);
/// assert_eq!(session.poll_timeout(), Some(500_000_000));
///
/// // A datagram from another address is counted and dropped.
/// let (source, bytes) = ("10.0.0.1:1510".parse()?, &[][..]);
/// session.handle_input(1_000, Input::Datagram { source, bytes }, &mut |_| {});
/// assert_eq!(session.counters().wrong_source, 1);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Session {
    common: Common,
    schedule: Schedule,
    /// The server's own bitstream and connection, once it has answered.
    server: Option<Server>,
    clock: CaptureClock,
    /// Stamp of the echo request that waits for its answer.
    echo_stamp: Option<u64>,
    sequence: Sequence,
    consistency: Consistency,
    definitions_current: bool,
    /// What the last definitions had that could not be decoded.
    unreadable: Option<DecodeError>,
    /// The newest frame had the flag "models changed".
    models_changed: bool,
    /// Frames in a row that could not be decoded.
    undecodable: u32,
}

/// What a server said of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Server {
    natnet_version: [u8; 4],
    connection: Option<Connection>,
}

/// When each message is due next, on the local clock.
#[derive(Clone, Copy, Debug, Default)]
struct Schedule {
    /// CONNECT, or the bitstream request.
    handshake_ns: u64,
    bitstream_attempts: u32,
    echo_ns: u64,
    models_ns: u64,
    /// When the definitions are requested again if they lack a body.
    models_retry_ns: u64,
    keep_alive_ns: u64,
    /// Silence counts from here when no frame arrived.
    listening_since_ns: u64,
}

impl Schedule {
    /// Every message is due at `now_ns`.
    const fn begin(now_ns: u64) -> Self {
        Self {
            handshake_ns: now_ns,
            bitstream_attempts: 0,
            echo_ns: now_ns,
            models_ns: now_ns,
            models_retry_ns: now_ns,
            keep_alive_ns: now_ns,
            listening_since_ns: now_ns,
        }
    }

    /// The definitions are due at `at_ns` or earlier.
    fn models_by(&mut self, at_ns: u64) {
        self.models_ns = self.models_ns.min(at_ns);
    }

    /// The definitions were requested.
    fn models_requested(&mut self, now_ns: u64, poll_ns: u64, have_been_read: bool) {
        let retry_ns = if have_been_read {
            INCOMPLETE_MODELS_NS
        } else {
            UNREAD_MODELS_NS
        };
        self.models_ns = now_ns.saturating_add(retry_ns.min(poll_ns));
    }

    /// The definitions were read: they are due again after the polling interval.
    const fn models_read(&mut self, now_ns: u64, poll_ns: u64) {
        self.models_retry_ns = self.models_ns;
        self.models_ns = now_ns.saturating_add(poll_ns);
    }

    /// The definitions that were read lack a body: they are due as if they had not
    /// been read.
    const fn models_incomplete(&mut self) {
        self.models_ns = self.models_retry_ns;
    }
}

impl Session {
    /// A session that has not connected yet.
    ///
    /// # Errors
    /// A value of the configuration can't be used.
    pub fn new(config: SessionConfig) -> Result<Self, SessionConfigError> {
        config.validate()?;
        Ok(Self {
            schedule: Schedule::default(),
            server: None,
            clock: CaptureClock::new(None, &config.timing),
            echo_stamp: None,
            sequence: Sequence::default(),
            consistency: Consistency::default(),
            definitions_current: false,
            unreadable: None,
            models_changed: false,
            undecodable: 0,
            common: Common::new(config),
        })
    }

    /// Whether the streaming ids have the names of the definitions read last.
    pub const fn definitions_current(&self) -> bool {
        self.definitions_current
    }

    /// `None` for servers before 3.0: they have no echo and send no frequency.
    fn echo_due_ns(&self) -> Option<u64> {
        let connection = self.server?.connection?;
        connection.ticks_per_second.map(|_| self.schedule.echo_ns)
    }

    fn keep_alive_due_ns(&self) -> Option<u64> {
        matches!(self.common.config.transport, Transport::Unicast { .. })
            .then_some(self.schedule.keep_alive_ns)
    }

    fn silence_due_ns(&self) -> u64 {
        self.decodable_until_ns()
            .saturating_add(self.common.config.timing.reconnect_after_ns)
    }

    /// When the last frame arrived that could be decoded, or when the session began
    /// to wait for the first.
    fn decodable_until_ns(&self) -> u64 {
        let frame_ns = self.common.last_frame_ns.unwrap_or_default();
        frame_ns.max(self.schedule.listening_since_ns)
    }

    /// What is due to be sent while frames arrive.
    fn poll_streaming(&mut self, now_ns: u64) -> Option<Transmit> {
        let timing = self.common.config.timing;
        let is_due = |due_ns| now_ns >= due_ns;
        if self.echo_due_ns().is_some_and(is_due) {
            let exchanges = self.clock.echo.as_ref().map_or(0, EchoClock::len);
            let is_quick = exchanges < QUICK_ECHOES;
            let most_ns = if is_quick { QUICK_ECHO_NS } else { u64::MAX };
            let interval_ns = timing.echo_ns.min(most_ns);
            self.schedule.echo_ns = now_ns.saturating_add(interval_ns);
            self.echo_stamp = Some(now_ns);
            let client_stamp = now_ns;
            return self.transmit(&ClientMessage::EchoRequest { client_stamp });
        }
        if now_ns >= self.schedule.models_ns {
            let (poll_ns, are_current) = (timing.model_poll_ns, self.definitions_current);
            self.schedule.models_requested(now_ns, poll_ns, are_current);
            return self.transmit(&ClientMessage::RequestModelDefinitions);
        }
        if self.keep_alive_due_ns().is_some_and(is_due) {
            self.schedule.keep_alive_ns = now_ns.saturating_add(timing.keep_alive_ns);
            return self.transmit(&ClientMessage::KeepAlive);
        }
        None
    }

    fn bitstream_request(&self, requested: BitstreamVersion) -> Option<Transmit> {
        let mut text: heapless::String<24> = heapless::String::new();
        // "Bitstream,255.255" fits.
        core::fmt::write(&mut text, format_args!("Bitstream,{requested}")).ok()?;
        self.transmit(&ClientMessage::Request(&text))
    }

    fn transmit(&self, message: &ClientMessage<'_>) -> Option<Transmit> {
        let mut bytes = heapless::Vec::new();
        // Every message of a session fits; one that did not would not be sent.
        bytes.resize_default(bytes.capacity()).ok()?;
        let len = encode::client_message(message, &mut bytes).ok()?;
        bytes.truncate(len);
        Some(Transmit {
            destination: self.common.server(),
            on_stream: false,
            bytes,
        })
    }
}

impl PoseSource for Session {
    fn handle_input(
        &mut self,
        now_ns: u64,
        input: Input<'_>,
        on_output: &mut dyn FnMut(Output<'_>),
    ) -> usize {
        // NatNet has datagrams only.
        if let Input::Datagram { source, bytes } = input {
            self.datagram(source, bytes, &mut Wake { now_ns, on_output });
        }
        0
    }

    fn handle_timeout(&mut self, now_ns: u64, on_output: &mut dyn FnMut(Output<'_>)) {
        if self.common.is_closing() {
            return;
        }
        let wake = &mut Wake { now_ns, on_output };
        self.common.notice_silence(wake);
        match self.common.phase {
            Phase::Streaming(_) if now_ns >= self.silence_due_ns() => {
                self.restart(RestartReason::Silence, wake);
            }
            Phase::Negotiating(requested)
                if now_ns >= self.schedule.handshake_ns
                    && self.schedule.bitstream_attempts >= BITSTREAM_ATTEMPTS =>
            {
                self.keep_bitstream(requested, wake);
            }
            _ => {}
        }
    }

    fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit> {
        let has_given_up = self.schedule.bitstream_attempts >= BITSTREAM_ATTEMPTS;
        match self.common.phase {
            Phase::Closed | Phase::Open | Phase::Foreign => None,
            Phase::Closing => {
                self.common.phase = Phase::Closed;
                self.transmit(&ClientMessage::Disconnect)
            }
            Phase::Streaming(_) => self.poll_streaming(now_ns),
            _ if now_ns < self.schedule.handshake_ns => None,
            Phase::Connecting | Phase::Refused(_) => {
                self.try_later(now_ns);
                self.transmit(&ClientMessage::Connect(Connect {
                    name: CLIENT_NAME,
                    // Requested as a text, which is answered.
                    requested_bitstream: None,
                }))
            }
            Phase::Negotiating(_) if has_given_up => None,
            Phase::Negotiating(requested) => {
                self.schedule.bitstream_attempts += 1;
                self.try_later(now_ns);
                self.bitstream_request(requested)
            }
        }
    }

    fn poll_timeout(&self) -> Option<u64> {
        match self.common.phase {
            Phase::Closed | Phase::Open | Phase::Foreign => None,
            Phase::Closing => Some(0),
            Phase::Connecting | Phase::Refused(_) | Phase::Negotiating(_) => {
                let stale_ns = self.common.stale_due_ns().unwrap_or(u64::MAX);
                Some(self.schedule.handshake_ns.min(stale_ns))
            }
            Phase::Streaming(_) => {
                let due_ns = self.schedule.models_ns.min(self.silence_due_ns());
                let (echo_ns, stale_ns) = (self.echo_due_ns(), self.common.stale_due_ns());
                let some_ns = [echo_ns, self.keep_alive_due_ns(), stale_ns];
                some_ns.into_iter().flatten().chain([due_ns]).min()
            }
        }
    }

    fn unreadable(&self) -> Option<DecodeError> {
        self.unreadable
    }

    /// Call it directly after the [`Names`](Output::Names) that lack the body: they are requested
    /// within half a second, not after [`Timing::model_poll_ns`](crate::Timing).
    fn request_names_again(&mut self) {
        self.schedule.models_incomplete();
    }

    fn is_contradicted(&self, now_ns: u64) -> bool {
        self.consistency.is_distrusted(now_ns)
    }

    fn common(&self) -> &Common {
        &self.common
    }

    fn common_mut(&mut self) -> &mut Common {
        &mut self.common
    }
}
