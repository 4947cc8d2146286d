//! What became of a datagram, and the frame that it may have held.

use crate::{
    axes::UpAxis,
    body::{Bodies, Body},
    capture::CaptureTime,
    codec::{DecodeError, FrameFlags, ModelDefinitions},
};

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
