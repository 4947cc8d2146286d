//! What every source of poses has in common, whatever the protocol of its server.

use core::net::{IpAddr, SocketAddr};

use crate::{
    body::{Bodies, Body, CaptureTime, UpAxis},
    codec::{BitstreamVersion, DecodeError, FrameFlags, UnsupportedVersion},
    config::SessionConfig,
    names::Names,
};

/// A session with a server of poses, without I/O.
///
/// It is called as every session ([order of the calls](crate#order-of-the-calls)). A protocol
/// over a stream also says which stream its owner must keep open ([`stream`](Self::stream)).
pub trait PoseSource {
    /// Takes what arrived at `now_ns`. Returns how many bytes of a stream were used: the rest
    /// begins a message that is not complete, and is handed over again with what follows it.
    fn handle_input(
        &mut self,
        now_ns: u64,
        input: Input<'_>,
        on_output: &mut dyn FnMut(Output<'_>),
    ) -> usize;

    /// Acts on silence: hand over what has arrived before.
    fn handle_timeout(&mut self, now_ns: u64, on_output: &mut dyn FnMut(Output<'_>));

    /// The next bytes to send now; call it until it returns `None`. A datagram that the socket does
    /// not take may be dropped: the session repeats what matters.
    fn poll_transmit(&mut self, now_ns: u64) -> Option<Transmit>;

    /// When the session must be called next, on the local clock; `None` once it is closed.
    fn poll_timeout(&self) -> Option<u64>;

    /// The stream to keep open. Another value than before: close the old one, and open this.
    fn stream(&self) -> Option<Stream> {
        None
    }

    /// Why the names that the server sent last, or a part of them, can't be read.
    fn unreadable(&self) -> Option<DecodeError> {
        None
    }

    /// The names lack the body that is needed: ask for them again soon.
    fn request_names_again(&mut self) {}

    /// Whether the frames are distrusted, because two senders use the server's address.
    fn is_contradicted(&self, _now_ns: u64) -> bool {
        false
    }

    /// What every session keeps.
    #[doc(hidden)]
    fn common(&self) -> &Common;

    /// What every session keeps.
    #[doc(hidden)]
    fn common_mut(&mut self) -> &mut Common;

    /// Replaces [`Timing::stamp_offset_ns`](crate::Timing), from the next frame on.
    fn set_stamp_offset_ns(&mut self, offset_ns: i64) {
        self.common_mut().config.timing.stamp_offset_ns = offset_ns;
    }

    /// Leaves the server: [`poll_transmit`](Self::poll_transmit) returns the last message, if there
    /// is one, and then nothing more.
    fn close(&mut self) {
        self.common_mut().phase = Phase::Closing;
    }

    /// How far the session is.
    fn phase(&self) -> Phase {
        self.common().phase
    }

    /// For how long the stream of frames has been silent, if that is longer than
    /// [`Timing::stale_after_ns`](crate::Timing).
    fn stale_for_ns(&self, now_ns: u64) -> Option<u64> {
        let common = self.common();
        let silent_ns = now_ns.saturating_sub(common.last_frame_ns?);
        (silent_ns > common.config.timing.stale_after_ns).then_some(silent_ns)
    }

    /// The address of the last datagram that did not come from the server's.
    fn other_source(&self) -> Option<IpAddr> {
        self.common().other_source
    }

    /// What was counted so far.
    fn counters(&self) -> SessionCounters {
        self.common().counters
    }
}

/// What arrives at a session.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    /// A datagram, and from where.
    Datagram {
        /// Address and port of the sender.
        source: SocketAddr,
        /// Contents.
        bytes: &'a [u8],
    },
    /// The stream is open.
    Opened(LocalEnd),
    /// All bytes of the stream that have not been used.
    Stream(&'a [u8]),
    /// The stream could not be opened, or has ended.
    Closed,
}

/// The owner's end of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LocalEnd {
    /// The address from which the stream was opened.
    pub address: IpAddr,
    /// The port at which the owner receives datagrams.
    pub datagram_port: u16,
}

/// A stream that the owner keeps open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stream {
    /// The server's address and port.
    pub server: SocketAddr,
    /// Counts the attempts: another number is another stream to the same server.
    pub attempt: u32,
}

/// What a session says to its owner, in order.
#[derive(Clone, Debug)]
pub enum Output<'a> {
    /// A rare event.
    Event(SessionEvent),
    /// The names of the server's bodies.
    Names(Names<'a>),
    /// The newest frame.
    Frame(PoseFrame<'a>),
}

/// The longest piece that a session sends: CONNECT.
pub(crate) const MAX_LEN: usize = 288;

/// Bytes to send.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Transmit {
    /// The address to send them to.
    pub destination: SocketAddr,
    /// Whether they are to follow the others on the stream, and are no datagram.
    pub on_stream: bool,
    /// The bytes.
    pub bytes: heapless::Vec<u8, MAX_LEN>,
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

/// A rare event, worth a line in the log. Poses are not events: they are in [`Output::Frame`].
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
    /// the definitions have been read ([`Output::Names`]).
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
    pub fn bodies(&self) -> Bodies<'a> {
        self.bodies.clone()
    }

    /// The up axis that the poses were read with.
    pub const fn up_axis(&self) -> UpAxis {
        self.bodies.up_axis
    }

    /// The rigid body with this streaming id; `None` when the frame does not list
    /// it.
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

/// A call of the owner: its time, and who takes what is said.
pub(crate) struct Wake<'a> {
    pub(crate) now_ns: u64,
    pub(crate) on_output: &'a mut dyn FnMut(Output<'_>),
}

impl Wake<'_> {
    pub(crate) fn tell(&mut self, event: SessionEvent) {
        (self.on_output)(Output::Event(event));
    }
}

/// Other addresses that are reported: each once.
const OTHER_SOURCES: usize = 4;

/// What every session keeps.
#[derive(Clone, Debug)]
pub struct Common {
    pub(crate) config: SessionConfig,
    pub(crate) phase: Phase,
    pub(crate) last_frame_ns: Option<u64>,
    is_stale: bool,
    /// Other addresses that datagrams came from: the first ones, and the latest.
    other_sources: heapless::Vec<IpAddr, OTHER_SOURCES>,
    other_source: Option<IpAddr>,
    pub(crate) counters: SessionCounters,
}

impl Common {
    pub(crate) fn new(config: SessionConfig) -> Self {
        Self {
            config,
            phase: Phase::Connecting,
            last_frame_ns: None,
            is_stale: false,
            other_sources: heapless::Vec::new(),
            other_source: None,
            counters: SessionCounters::default(),
        }
    }

    pub(crate) const fn is_closing(&self) -> bool {
        matches!(self.phase, Phase::Closing | Phase::Closed)
    }

    pub(crate) const fn server(&self) -> SocketAddr {
        SocketAddr::new(self.config.server, self.config.command_port)
    }

    /// Whether this is the server's address; another one is counted, and reported once.
    pub(crate) fn is_server(&mut self, address: IpAddr, wake: &mut Wake<'_>) -> bool {
        if address == self.config.server {
            return true;
        }
        self.counters.wrong_source += 1;
        self.other_source = Some(address);
        if !self.other_sources.contains(&address) && self.other_sources.push(address).is_ok() {
            wake.tell(SessionEvent::OtherSource(address));
        }
        false
    }

    /// A frame arrived that is the newest.
    pub(crate) const fn frame(&mut self, now_ns: u64) {
        self.counters.frames += 1;
        self.last_frame_ns = Some(now_ns);
        self.is_stale = false;
    }

    /// The capture of a frame that arrived at `now_ns`, less the constant error of the stamps: never
    /// after it arrived. `None` if it exceeds the arrival by more than its uncertainty.
    pub(crate) const fn at_arrival(
        &mut self,
        mut capture: CaptureTime,
        now_ns: u64,
    ) -> Option<CaptureTime> {
        let offset_ns = self.config.timing.stamp_offset_ns;
        capture.time_ns = capture.time_ns.saturating_sub_signed(offset_ns);
        if capture.time_ns > now_ns {
            if capture.time_ns - now_ns > capture.uncertainty_ns {
                return None;
            }
            capture.time_ns = now_ns;
            self.counters.capture_clamped += 1;
        }
        Some(capture)
    }

    /// When the stream of frames is stale: silent for longer than the limit.
    pub(crate) fn stale_due_ns(&self) -> Option<u64> {
        let limit_ns = self.config.timing.stale_after_ns.saturating_add(1);
        let due_ns = self.last_frame_ns?.saturating_add(limit_ns);
        (!self.is_stale).then_some(due_ns)
    }

    /// Reports that the stream of frames has become stale.
    pub(crate) fn notice_silence(&mut self, wake: &mut Wake<'_>) {
        let is_due = |due_ns| wake.now_ns >= due_ns;
        if self.stale_due_ns().is_some_and(is_due) {
            self.is_stale = true;
            self.counters.stale += 1;
            wake.tell(SessionEvent::Stale);
        }
    }
}
