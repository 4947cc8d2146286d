//! The NatNet wire format: bytes to values.
//!
//! Every decoder is strict: it reads within the bounds of the datagram, checks every
//! declared size against the bytes consumed, and accepts a packet only when no byte is
//! left. Nothing is copied or allocated: decoded values borrow the datagram. Start with
//! [`ServerMessage::decode`]; the opposite direction is in [`crate::encode`]. Layouts differ by the
//! [`BitstreamVersion`].

mod frame;
mod message;
mod packet;

use core::fmt;

pub use frame::{
    CameraTicks, Frame, FrameFlags, PrecisionTime, RigidBodies, RigidBody, SectionCounts,
};
pub use message::{
    ClientMessage, Connect, Connection, DataChannel, Echo, ModelDefinitions, Response,
    RigidBodyDefinition, RigidBodyDefinitions, SENDER_LEN, ServerInfo, ServerMessage,
    bitstream_request,
};
pub(crate) use message::{SENDER_NAME_LEN, dataset};
pub use packet::{DecodeError, HEADER_LEN, MAX_DATAGRAM_LEN, MessageId, Packet};

/// A NatNet bitstream version whose layout this crate reads.
///
/// Only supported versions can be constructed, so every value can be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BitstreamVersion {
    major: u8,
    minor: u8,
}

/// The server's bitstream has a layout that this crate does not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "NatNet bitstream {major}.{minor} is not supported, only {oldest} to {newest}: \
     request a supported one (unicast) or change the server's version",
    oldest = BitstreamVersion::OLDEST,
    newest = BitstreamVersion::NEWEST
)]
pub struct UnsupportedVersion {
    /// Major number on the wire.
    pub major: u8,
    /// Minor number on the wire.
    pub minor: u8,
}

impl BitstreamVersion {
    /// Motive 1.7. The first with a double-precision timestamp.
    pub const V2_7: Self = Self { major: 2, minor: 7 };
    /// Motive 1.9. Adds force plates.
    pub const V2_9: Self = Self { major: 2, minor: 9 };
    /// Adds devices.
    pub const V2_11: Self = Self {
        major: 2,
        minor: 11,
    };
    /// Motive 2.0. Adds the camera clock's ticks to frames and its frequency to the server
    /// information, residuals to markers, and markers to rigid-body definitions; drops latency, and
    /// markers inside rigid bodies.
    pub const V3_0: Self = Self { major: 3, minor: 0 };
    /// Motive 2.1 to 2.3.
    pub const V3_1: Self = Self { major: 3, minor: 1 };
    /// Motive 3.0. Adds marker names to rigid-body definitions.
    pub const V4_0: Self = Self { major: 4, minor: 0 };
    /// Motive 3.1. Adds sizes to sections, assets and precision time.
    pub const V4_1: Self = Self { major: 4, minor: 1 };
    /// 4.1's frame layout; adds a rotation to rigid-body definitions.
    pub const V4_2: Self = Self { major: 4, minor: 2 };
    /// The oldest version read.
    pub const OLDEST: Self = Self::V2_7;
    /// The newest version read. 4.5 is not verified by any public source.
    pub const NEWEST: Self = Self { major: 4, minor: 4 };

    /// The version `major.minor`.
    ///
    /// # Errors
    /// Outside [`OLDEST`](Self::OLDEST) to [`NEWEST`](Self::NEWEST).
    pub fn new(major: u8, minor: u8) -> Result<Self, UnsupportedVersion> {
        let version = Self { major, minor };
        if (Self::OLDEST..=Self::NEWEST).contains(&version) {
            return Ok(version);
        }
        Err(UnsupportedVersion { major, minor })
    }

    /// The version in the four bytes `major, minor, build, revision` of the wire.
    ///
    /// # Errors
    /// Those of [`new`](Self::new).
    pub fn from_wire(bytes: [u8; 4]) -> Result<Self, UnsupportedVersion> {
        let [major, minor, _, _] = bytes;
        Self::new(major, minor)
    }

    /// The four bytes `major, minor, build, revision` of the wire.
    pub const fn to_wire(self) -> [u8; 4] {
        [self.major, self.minor, 0, 0]
    }

    /// The first number.
    pub const fn major(self) -> u8 {
        self.major
    }

    /// The second number.
    pub const fn minor(self) -> u8 {
        self.minor
    }
}

impl fmt::Display for BitstreamVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}
