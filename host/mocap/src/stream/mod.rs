//! A session over a stream, with frames on the stream or as datagrams.
//!
//! [`StreamSession`] keeps the stream open, notices silence, puts frames in order and finds when
//! they were captured ([`Link`]). What is said on the stream is the protocol's own
//! ([`Dialogue`]).

mod link;
mod session;

pub(crate) use link::{LastFrame, Link};
pub use session::StreamSession;

use crate::pose_source::Output;

/// How a message arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Over {
    /// On the stream.
    Stream,
    /// In a datagram.
    Datagram,
}

/// What became of the first message of some bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// It has this length, and was used.
    Used(usize),
    /// It is not complete.
    Incomplete,
}

/// Why a stream can't go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Broken {
    /// The bytes are no message.
    NoMessage,
    /// The server speaks another protocol, or a version that is not supported.
    Foreign,
}

/// The longest message that is taken from a stream.
pub(crate) const LONGEST: usize = 1 << 20;

/// What a protocol says and understands.
pub trait Dialogue {
    /// The stream is open; nothing of an earlier one is valid.
    fn open(&mut self, now_ns: u64, link: &mut Link);

    /// Reads the first message of `bytes`.
    ///
    /// # Errors
    /// The stream can't go on.
    fn read(
        &mut self,
        now_ns: u64,
        bytes: &[u8],
        over: Over,
        link: &mut Link,
        on_output: &mut dyn FnMut(Output<'_>),
    ) -> Result<Progress, Broken>;

    /// Says what is due.
    fn poll(&mut self, now_ns: u64, link: &mut Link);

    /// When something is to be said next.
    fn due_ns(&self) -> u64;

    /// The names lack the body that is needed.
    fn names_incomplete(&mut self) {}
}
