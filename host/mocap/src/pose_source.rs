//! What every source of poses has in common, whatever the protocol of its server.

use core::net::{IpAddr, SocketAddr};

use crate::{
    codec::DecodeError,
    names::Names,
    session::{Phase, PoseFrame, SessionCounters, SessionEvent, Transmit},
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

    /// Acts on silence.
    fn handle_timeout(&mut self, now_ns: u64, on_output: &mut dyn FnMut(Output<'_>));

    /// The next bytes to send now; call it until it returns `None`.
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

    /// Replaces [`Timing::stamp_offset_ns`](crate::Timing), from the next frame on.
    fn set_stamp_offset_ns(&mut self, offset_ns: i64);

    /// Leaves the server.
    fn close(&mut self);

    /// How far the session is.
    fn phase(&self) -> Phase;

    /// For how long the stream of frames has been silent, if that is longer than
    /// [`Timing::stale_after_ns`](crate::Timing).
    fn stale_for_ns(&self, now_ns: u64) -> Option<u64>;

    /// The address of the last datagram that did not come from the server's.
    fn other_source(&self) -> Option<IpAddr> {
        None
    }

    /// Whether the frames are distrusted, because two senders use the server's address.
    fn is_contradicted(&self, _now_ns: u64) -> bool {
        false
    }

    /// What was counted so far.
    fn counters(&self) -> SessionCounters;
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
