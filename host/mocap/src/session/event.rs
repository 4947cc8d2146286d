//! What a session tells its shell.

use core::net::SocketAddr;

use crate::binding::Binding;
use crate::codec::{BitstreamVersion, DecodeError, UnsupportedVersion};
use crate::pose::PoseState;

/// The longest datagram a session sends: CONNECT.
const MAX_LEN: usize = 288;

/// A datagram to send.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Datagram {
    /// Where to.
    pub destination: SocketAddr,
    /// What.
    pub bytes: heapless::Vec<u8, MAX_LEN>,
}

/// How far a conversation is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// The server has not answered yet.
    Connecting,
    /// The server's bitstream is not supported and it did not change it. The
    /// session keeps asking, in case somebody changes it.
    Refused(UnsupportedVersion),
    /// The server was asked for this bitstream.
    Negotiating(BitstreamVersion),
    /// Frames of this bitstream are taken.
    Streaming(BitstreamVersion),
    /// The goodbye is yet to be sent.
    Closing,
    /// It was sent.
    Closed,
}

/// What became of a datagram.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// The newest frame, and what it says of the body.
    Frame(Observation),
    /// A frame older than the newest: dropped.
    Late,
    /// The newest frame again: dropped.
    Duplicate,
    /// A reply the session was waiting for.
    Reply,
    /// Well-formed, but nothing to be done with.
    Ignored,
    /// From another address than the server's.
    WrongSource,
    /// Not to be decoded.
    Malformed(DecodeError),
}

/// What a frame says of the body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// The server's number of the frame.
    pub frame_number: i32,
    /// When it arrived, on the local monotonic clock.
    pub receive_time_ns: u64,
    /// What it says.
    pub state: PoseState,
}

/// Something worth a line in the log. It is rare: poses come as [`Outcome`]s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event {
    /// The server answered and frames are awaited.
    Connected(Connected),
    /// The server's bitstream is not supported, and it did not change it.
    Refused(UnsupportedVersion),
    /// The server did not change its bitstream; its own is read.
    BitstreamKept {
        /// What it was asked for.
        requested: BitstreamVersion,
        /// What it sends.
        kept: BitstreamVersion,
    },
    /// The server sends multicast and unicast is configured, or the reverse:
    /// frames will hardly come.
    TransportMismatch {
        /// What the server does.
        server_multicast: bool,
    },
    /// The configured name was found, or not.
    Binding(Binding),
    /// No frame came for longer than the configured time.
    Stale,
    /// The conversation begins anew.
    Restarted(RestartReason),
}

/// What was agreed with the server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Connected {
    /// The bitstream of the frames.
    pub version: BitstreamVersion,
    /// The port the server says it sends frames from (from 3.0 on).
    pub data_port: Option<u16>,
    /// Whether frames will carry mid-exposure time that echoes can map.
    pub has_camera_clock: bool,
}

/// Why a conversation begins anew.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RestartReason {
    /// No frame came for long.
    Silence,
    /// The server's clock went backward.
    ClockBackward,
    /// The frames go on from an earlier point.
    FramesBackward,
    /// The server said goodbye.
    ServerLeft,
    /// The server says it is another version than before.
    ServerChanged,
    /// Many frames in a row could not be decoded; the last one's error.
    Undecodable(DecodeError),
}
