//! The session of one client with one server.
//!
//! What a session reports is in [`event`], how it reaches a server and what it makes of datagrams
//! in [`receive`], and when it sends what in [`transmit`].

mod receive;
mod source;
mod transmit;

use core::net::IpAddr;

use self::transmit::Schedule;
use crate::{
    body::{Bodies, Body, CaptureTime, UpAxis},
    clock::CaptureClock,
    codec::{
        BitstreamVersion, Connection, DecodeError, FrameFlags, ModelDefinitions, UnsupportedVersion,
    },
    config::{SessionConfig, SessionConfigError, Transport},
    consistency::{Consistency, Sequence},
};

pub(crate) use transmit::MAX_LEN;
pub use transmit::Transmit;

/// A NatNet client without socket and clock: it follows all rigid bodies of one
/// server.
///
/// [The crate's documentation](crate) describes how to call it. Create one with
/// [`new`](Self::new); the first [`poll_transmit`](Self::poll_transmit) begins the
/// handshake.
///
/// ```
/// use singletrack_mocap::codec::ServerMessage;
/// use singletrack_mocap::{
///     DatagramOutcome, PoseSource, Session, SessionConfig, Transport, UpAxis,
/// };
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
/// let outcome = session.handle_datagram(1_000, "10.0.0.1:1510".parse()?, &[], &mut |_| {});
/// assert!(matches!(outcome, DatagramOutcome::WrongSource));
/// assert_eq!(session.counters().wrong_source, 1);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Session {
    config: SessionConfig,
    phase: Phase,
    schedule: Schedule,
    /// The server's own bitstream and connection, once it has answered.
    server: Option<Server>,
    clock: CaptureClock,
    /// Stamp of the echo request that waits for its answer.
    echo_stamp: Option<u64>,
    sequence: Sequence,
    consistency: Consistency,
    /// Other addresses that datagrams came from: the first ones, and the latest.
    other_sources: heapless::Vec<IpAddr, OTHER_SOURCES>,
    other_source: Option<IpAddr>,
    definitions_current: bool,
    /// What the last definitions had that could not be decoded.
    unreadable: Option<DecodeError>,
    /// The newest frame had the flag "models changed".
    models_changed: bool,
    last_frame_ns: Option<u64>,
    stale: bool,
    /// Frames in a row that could not be decoded.
    undecodable: u32,
    counters: SessionCounters,
}

/// Other addresses that are reported: each once.
const OTHER_SOURCES: usize = 4;

/// What a server said of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Server {
    natnet_version: [u8; 4],
    native: Result<BitstreamVersion, UnsupportedVersion>,
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
            phase: Phase::Connecting,
            schedule: Schedule::default(),
            server: None,
            clock: CaptureClock::new(None, &config.timing),
            echo_stamp: None,
            sequence: Sequence::default(),
            consistency: Consistency::default(),
            other_sources: heapless::Vec::new(),
            other_source: None,
            definitions_current: false,
            unreadable: None,
            models_changed: false,
            last_frame_ns: None,
            stale: false,
            undecodable: 0,
            counters: SessionCounters::default(),
            config,
        })
    }

    /// Whether the streaming ids have the names of the definitions read last.
    #[must_use]
    pub const fn definitions_current(&self) -> bool {
        self.definitions_current
    }

    // Deadlines and changes that the other files share.

    fn forget_definitions(&mut self, on_event: &mut impl FnMut(SessionEvent)) {
        if self.definitions_current {
            self.definitions_current = false;
            on_event(SessionEvent::DefinitionsOutdated);
        }
    }

    /// `None` for servers before 3.0: they have no echo and send no frequency.
    fn echo_due_ns(&self) -> Option<u64> {
        let connection = self.server?.connection?;
        connection.ticks_per_second.map(|_| self.schedule.echo_ns)
    }

    fn keep_alive_due_ns(&self) -> Option<u64> {
        matches!(self.config.transport, Transport::Unicast { .. })
            .then_some(self.schedule.keep_alive_ns)
    }

    fn stale_due_ns(&self) -> Option<u64> {
        if self.stale {
            return None;
        }
        // A stream is stale when it is silent for longer than the limit.
        let limit_ns = self.config.timing.stale_after_ns.saturating_add(1);
        Some(self.last_frame_ns?.saturating_add(limit_ns))
    }

    fn silence_due_ns(&self) -> u64 {
        self.decodable_until_ns()
            .saturating_add(self.config.timing.reconnect_after_ns)
    }

    /// When the last frame arrived that could be decoded, or when the session began
    /// to wait for the first.
    fn decodable_until_ns(&self) -> u64 {
        self.last_frame_ns
            .unwrap_or_default()
            .max(self.schedule.listening_since_ns)
    }
}

/// How far a session is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Phase {
    /// The server has not answered yet.
    Connecting,
    /// The server's bitstream is not supported, and the server did not change it.
    /// The session keeps asking, in case an operator changes it.
    Refused(UnsupportedVersion),
    /// The server was asked for this bitstream.
    Negotiating(BitstreamVersion),
    /// Frames of this bitstream are accepted.
    Streaming(BitstreamVersion),
    /// The stream is open, and frames are accepted (VRPN, Qualisys).
    Open,
    /// What answers speaks another protocol, or a version of it that is not supported.
    Foreign,
    /// The disconnect message is yet to be sent.
    Closing,
    /// The disconnect message was sent.
    Closed,
}

/// A rare event, worth a line in the log. Poses are not events: they are in
/// [`DatagramOutcome::Frame`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum SessionEvent {
    /// The server answered, and the session waits for frames.
    Connected(Connected),
    /// The server's bitstream is not supported, and the server did not change it.
    Refused(UnsupportedVersion),
    /// The stream to the server is open, and the server speaks its protocol.
    Opened,
    /// What answers speaks another protocol, or a version of it that is not supported.
    Foreign,
    /// Frames arrive over the stream, because none arrived as datagrams.
    DatagramsBlocked,
    /// The server did not change its bitstream; the session reads the server's own.
    BitstreamKept {
        /// The bitstream that was requested.
        requested: BitstreamVersion,
        /// The bitstream that the server sends.
        kept: BitstreamVersion,
    },
    /// The server sends multicast and unicast is configured, or the reverse. Frames
    /// will probably not arrive.
    TransportMismatch {
        /// Whether the server sends multicast.
        server_multicast: bool,
    },
    /// Streaming ids may mean other bodies from now on. They are valid again when
    /// the definitions have been read
    /// ([`DatagramOutcome::Definitions`]).
    DefinitionsOutdated,
    /// The definitions, or one of them, can't be decoded: with another error than before. The bodies
    /// that can be read are known all the same.
    DefinitionsUnreadable(DecodeError),
    /// Datagrams arrive from another address than the server's, for the first time. They are
    /// counted and dropped.
    OtherSource(IpAddr),
    /// Frames contradict each other: two senders use the server's address. No frame has a
    /// capture time until a second without contradictions.
    Contradicted,
    /// No frame arrived for longer than [`Timing::stale_after_ns`](crate::Timing).
    Stale,
    /// The session starts over.
    Restarted(RestartReason),
}

/// The result of the handshake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Connected {
    /// The bitstream of the frames.
    pub version: BitstreamVersion,
    /// The port from which the server sends frames, as it reports (from 3.0 on).
    pub data_port: Option<u16>,
    /// Whether frames will carry mid-exposure time that echoes can map.
    pub has_camera_clock: bool,
}

/// Why a session starts over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum RestartReason {
    /// No frame arrived for longer than
    /// [`Timing::reconnect_after_ns`](crate::Timing).
    Silence,
    /// The server's clock went backward.
    ClockBackward,
    /// The frames continue from an earlier point.
    FramesBackward,
    /// The server disconnected.
    ServerLeft,
    /// The server reports another version than before.
    ServerChanged,
    /// Many frames in a row could not be decoded. This is the last one's error.
    Undecodable(DecodeError),
    /// The stream has ended, or could not be opened.
    StreamEnded,
    /// What arrived on the stream is no message.
    StreamBroken,
    /// No frame arrived as a datagram: they are requested over the stream.
    NoDatagrams,
}

/// What became of a datagram. Every case is counted as well.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum DatagramOutcome<'a> {
    /// The newest frame: the poses of all rigid bodies.
    Frame(PoseFrame<'a>),
    /// The model definitions: the names of the streaming ids.
    Definitions(ModelDefinitions<'a>),
    /// Another reply that the session waited for.
    Reply,
    /// A frame older than the newest: dropped.
    Late,
    /// The newest frame again: dropped.
    Duplicate,
    /// A good message that the session does not need: dropped.
    Ignored,
    /// From another address than the server's: dropped.
    WrongSource,
    /// It can't be decoded: dropped.
    Malformed(DecodeError),
}

/// The newest frame: the poses of all rigid bodies, and their time.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct PoseFrame<'a> {
    /// The server's number of the frame.
    pub number: i32,
    /// When the frame arrived, in nanoseconds of the local clock.
    pub receive_time_ns: u64,
    /// When the cameras saw the bodies. `None` when the frame has no usable time,
    /// or one after its arrival.
    pub capture: Option<CaptureTime>,
    /// The frame's flags.
    pub flags: FrameFlags,
    /// Whether the streaming ids have the names of the definitions read last.
    pub definitions_current: bool,
    pub(crate) bodies: Bodies<'a>,
}

impl<'a> PoseFrame<'a> {
    /// The rigid bodies in wire order, tracked or not.
    ///
    /// Two bodies with one id are both listed; [`body`](Self::body) reports them.
    #[must_use]
    pub fn bodies(&self) -> Bodies<'a> {
        self.bodies.clone()
    }

    /// The up axis that the poses were read with.
    #[must_use]
    pub const fn up_axis(&self) -> UpAxis {
        self.bodies.up_axis
    }

    /// The rigid body with this streaming id; `None` when the frame does not list
    /// it.
    #[must_use]
    pub fn body(&self, id: i32) -> Option<Body> {
        self.bodies.with_id(id)
    }
}

/// Counts since the session was made. Nothing resets them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct SessionCounters {
    /// Frames taken as the newest.
    pub frames: u64,
    /// Frame numbers that never arrived.
    pub lost: u64,
    /// Frames older than the newest: dropped.
    pub late: u64,
    /// Frames with the newest one's number: dropped.
    pub duplicates: u64,
    /// Times the server started its frame numbers again while its clock went on.
    pub renumbered: u64,
    /// Datagrams that could not be decoded.
    pub malformed: u64,
    /// Datagrams from another address.
    pub wrong_source: u64,
    /// Frames that contradict the stream: another port, other content for the same number, a
    /// clock ahead of time. Two senders use the server's address.
    pub contradictions: u64,
    /// Frames without a capture time because of contradictions just before.
    pub distrusted: u64,
    /// Frames before the bitstream was known: dropped.
    pub early: u64,
    /// Messages that answer no request.
    pub unsolicited: u64,
    /// Capture times moved back to the time of arrival, which they exceeded by no
    /// more than their uncertainty.
    pub capture_clamped: u64,
    /// Times the stream became stale.
    pub stale: u64,
    /// Times the session started over.
    pub restarts: u64,
    /// Echo exchanges used.
    pub echoes: u64,
    /// Times the clock mapping was discarded because an echo contradicted it.
    pub clock_steps: u64,
}
