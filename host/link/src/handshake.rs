//! From an open port to a configured board, and requests that wait for an answer.
//!
//! A request without an answer is dropped after some attempts ([`Pending`]); a stop is
//! repeated without end ([`Stop`]). A late request must not start the car, and a late
//! stop must still stop it.

use singletrack_protocol::{
    BoardMode, Disarm, EmergencyStop, RefusalReason, Request, Sequence, ToBoard, UNSOLICITED,
};

use crate::event::VersionMismatch;

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
    Greeting(Greeting),
    Configuring {
        pending: Pending,
        /// The reason of the board's last refusal.
        refused: Option<RefusalReason>,
    },
    Ready,
}

impl Phase {
    /// The configuration is due at `first_ns`.
    pub(crate) const fn configuring(
        sequence: Sequence,
        first_ns: u64,
        refused: Option<RefusalReason>,
    ) -> Self {
        let pending = Pending::new(sequence, first_ns);
        Self::Configuring { pending, refused }
    }

    /// Whether the board has answered and speaks the session's version.
    pub(crate) const fn is_connected(&self) -> bool {
        matches!(self, Self::Configuring { .. } | Self::Ready)
    }

    pub(crate) const fn greeting_mut(&mut self) -> Option<&mut Greeting> {
        match self {
            Self::Greeting(greeting) => Some(greeting),
            _ => None,
        }
    }
}

/// A greeting that is repeated until it is answered.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Greeting {
    pub(crate) nonce: u32,
    pub(crate) since_ns: u64,
    pub(crate) next_ns: u64,
    /// The software of the board that seems to have answered. The greeting itself comes back
    /// from a line that echoes; the identity that follows an answer is the board's alone.
    pub(crate) answered: Option<[u8; 3]>,
    /// A board of another version has answered.
    pub(crate) mismatch: Option<VersionMismatch>,
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

/// Time between two attempts.
pub const RETRY_INTERVAL_NS: u64 = 50_000_000;

/// How often a request is sent before it is dropped.
pub const ATTEMPTS: u8 = 3;

/// A request that is dropped after [`ATTEMPTS`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pending {
    pub(crate) sequence: Sequence,
    attempts: u8,
    /// When it is due to be sent or dropped.
    pub(crate) next_ns: u64,
}

impl Pending {
    /// A request to be sent first at `first_ns`.
    pub(crate) const fn new(sequence: Sequence, first_ns: u64) -> Self {
        Self {
            sequence,
            attempts: 0,
            next_ns: first_ns,
        }
    }

    pub(crate) const fn was_sent(&self) -> bool {
        self.attempts > 0
    }

    /// Whether to send it now; if so, that is one attempt.
    pub(crate) fn take_due(&mut self, now_ns: u64) -> bool {
        let due = self.attempts < ATTEMPTS && now_ns >= self.next_ns;
        if due {
            self.attempts += 1;
            self.next_ns = now_ns.saturating_add(RETRY_INTERVAL_NS);
        }
        due
    }

    /// Whether the time to answer the last attempt has passed.
    pub(crate) const fn is_exhausted(&self, now_ns: u64) -> bool {
        self.attempts >= ATTEMPTS && now_ns >= self.next_ns
    }
}

/// The two ways to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StopKind {
    Disarm,
    EmergencyStop,
}

impl StopKind {
    pub(crate) const fn request(self) -> Request {
        match self {
            Self::Disarm => Request::Disarm,
            Self::EmergencyStop => Request::EmergencyStop,
        }
    }
}

/// A stop, repeated until telemetry shows its effect.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stop {
    pub(crate) kind: StopKind,
    pub(crate) sequence: Sequence,
    pub(crate) next_ns: u64,
    answered: bool,
}

impl Stop {
    pub(crate) const fn new(kind: StopKind, sequence: Sequence, now_ns: u64) -> Self {
        Self {
            kind,
            sequence,
            next_ns: now_ns,
            answered: false,
        }
    }

    pub(crate) fn take_due(&mut self, now_ns: u64) -> Option<ToBoard> {
        if now_ns < self.next_ns {
            return None;
        }
        self.next_ns = now_ns.saturating_add(RETRY_INTERVAL_NS);
        let request = self.sequence;
        Some(match self.kind {
            StopKind::Disarm => Disarm { request }.into(),
            StopKind::EmergencyStop => EmergencyStop { request }.into(),
        })
    }

    /// Takes an answer; true when it is the first one to this request.
    pub(crate) fn answer(&mut self, request: Request, sequence: Sequence) -> bool {
        let matches = request == self.kind.request() && sequence == self.sequence;
        let first = matches && !self.answered;
        self.answered |= matches;
        first
    }

    /// Whether telemetry with this mode shows that the stop had its effect.
    ///
    /// A board may have been neutral before the request, with an earlier request to
    /// arm still on its way. Telemetry that follows the answer on the line was made
    /// after it, so the answer comes first.
    pub(crate) fn is_confirmed_by(&self, mode: BoardMode) -> bool {
        match self.kind {
            StopKind::Disarm => self.answered && !mode.is_armed(),
            StopKind::EmergencyStop => mode == BoardMode::EmergencyStopped,
        }
    }
}
