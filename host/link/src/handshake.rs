//! From an open port to a configured board.

use singletrack_protocol::{RefusalReason, Sequence, UNSOLICITED};

use crate::{event::VersionMismatch, request::Pending};

/// Time between two greetings. Opening the port resets the board, and its bootloader
/// discards the first greetings.
pub const HELLO_INTERVAL_NS: u64 = 100_000_000;

/// Time between two attempts that can only succeed after a change from outside:
/// another version, a refused configuration.
pub const SLOW_RETRY_NS: u64 = 1_000_000_000;

/// How far the handshake has come.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Phase {
    Disconnected,
    Greeting {
        greeting: Greeting,
        since_ns: u64,
    },
    VersionMismatch {
        greeting: Greeting,
        mismatch: VersionMismatch,
    },
    Configuring {
        pending: Pending,
        /// The reason of the board's last refusal.
        refused: Option<RefusalReason>,
    },
    Ready,
}

impl Phase {
    pub(crate) const fn configuring(sequence: Sequence, now_ns: u64) -> Self {
        Self::Configuring {
            pending: Pending::new(sequence, now_ns),
            refused: None,
        }
    }

    /// Whether the board has answered and speaks the session's version.
    pub(crate) const fn is_connected(&self) -> bool {
        matches!(self, Self::Configuring { .. } | Self::Ready)
    }

    pub(crate) const fn greeting(&self) -> Option<&Greeting> {
        match self {
            Self::Greeting { greeting, .. } | Self::VersionMismatch { greeting, .. } => {
                Some(greeting)
            }
            _ => None,
        }
    }

    pub(crate) const fn greeting_mut(&mut self) -> Option<&mut Greeting> {
        match self {
            Self::Greeting { greeting, .. } | Self::VersionMismatch { greeting, .. } => {
                Some(greeting)
            }
            _ => None,
        }
    }
}

/// A greeting that is repeated until it is answered.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Greeting {
    pub(crate) nonce: u32,
    pub(crate) next_ns: u64,
    /// The software of the board that seems to have answered. The greeting itself comes back
    /// from a line that echoes; the identity that follows an answer is the board's alone.
    pub(crate) answered: Option<[u8; 3]>,
}

/// Numbers that do not repeat from one handshake to the next, so that a late
/// answer is not taken for a new one (the `SplitMix64` generator).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Nonces(pub(crate) u64);

impl Nonces {
    pub(crate) fn next(&mut self) -> u32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let nonce = (z >> 32) as u32;
        if nonce == UNSOLICITED {
            UNSOLICITED.wrapping_add(1)
        } else {
            nonce
        }
    }
}
