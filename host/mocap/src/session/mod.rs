//! The session of one client with one server.
//!
//! How a session reaches a server and what it makes of datagrams is in [`receive`], and when it
//! sends what in [`transmit`].

mod receive;
mod transmit;

use self::transmit::{BITSTREAM_ATTEMPTS, CLIENT_NAME, Schedule};
use crate::{
    clock::CaptureClock,
    codec::{ClientMessage, Connect, Connection, DecodeError},
    config::{SessionConfig, SessionConfigError, Transport},
    consistency::{Consistency, Sequence},
    pose_source::{Common, Input, Output, Phase, PoseSource, RestartReason, Transmit, Wake},
};

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
