//! What a session reports to its owner.

use core::net::IpAddr;

use crate::codec::{BitstreamVersion, DecodeError, UnsupportedVersion};

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
/// [`DatagramOutcome::Frame`](super::DatagramOutcome::Frame).
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
    /// ([`DatagramOutcome::Definitions`](super::DatagramOutcome::Definitions)).
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
