//! Whether the frames of one address can come from one server, and which of them continue the stream:
//! only the newest.
//!
//! NatNet has no authentication, and a source address can be forged. Two senders that use the
//! same address contradict each other: in the port that frames come from, in the content of a
//! frame number, or in the server's clock. The session counts the contradictions, and trusts
//! no frame while they go on.

use core::num::NonZeroU64;

/// This number of frames in a row that are older than the newest, but follow each
/// other, means that the server started again.
const RESTART_AFTER: u32 = 10;

/// The place of a frame in the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    /// It is the newest; `lost` frames before it never arrived.
    Newest { lost: u64 },
    /// It is the newest by the server's clock; the numbers started again.
    Renumbered,
    /// It has the number of the newest frame.
    Duplicate,
    /// It is older than the newest.
    Late,
    /// The stream continues from an earlier point: the server started again.
    Restarted,
}

#[derive(Clone, Copy, Debug)]
struct Mark {
    number: i32,
    /// The server's clock when it sent the frame, in any unit; 0 if unknown.
    clock: u64,
}

impl Mark {
    /// How many numbers `self` is ahead of `other`; numbers wrap.
    const fn ahead_of(self, other: Self) -> i32 {
        self.number.wrapping_sub(other.number)
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Sequence {
    newest: Option<Mark>,
    suspect: Option<Mark>,
    suspects: u32,
}

impl Sequence {
    pub(crate) fn place(&mut self, number: i32, clock: u64) -> Order {
        let mark = Mark { number, clock };
        let Some(newest) = self.newest else {
            return self.accept(mark, Order::Newest { lost: 0 });
        };
        let ahead = mark.ahead_of(newest);
        if ahead == 0 {
            Order::Duplicate
        } else if ahead > 0 && clock >= newest.clock {
            let lost = u64::from(ahead.unsigned_abs()) - 1;
            self.accept(mark, Order::Newest { lost })
        } else if ahead < 0 && clock > newest.clock {
            self.accept(mark, Order::Renumbered)
        } else {
            self.suspect(number, clock)
        }
    }

    const fn accept(&mut self, mark: Mark, order: Order) -> Order {
        self.newest = Some(mark);
        self.suspect = None;
        self.suspects = 0;
        order
    }

    /// A frame that can't continue the stream. Many that follow each other mean that the
    /// server started again.
    pub(crate) fn suspect(&mut self, number: i32, clock: u64) -> Order {
        let mark = Mark { number, clock };
        let follows = self
            .suspect
            .is_some_and(|last| mark.ahead_of(last) > 0 && clock >= last.clock);
        self.suspects = if follows { self.suspects + 1 } else { 1 };
        self.suspect = Some(mark);
        if self.suspects >= RESTART_AFTER {
            Order::Restarted
        } else {
            Order::Late
        }
    }
}

/// How far the server's clock may advance beyond the local one between two frames, in ns. The
/// network delays frames, so that the server's clock falls behind; it never runs ahead.
const AHEAD_NS: u64 = 500_000_000;

/// The highest rate of frames, per second, and how many may have no time between them.
const MAX_FRAMES_PER_S: f64 = 2_500.0;
const BURST: f64 = 4.0;

/// This number of contradictions within [`WINDOW_NS`] distrusts the frames for as long again.
const DISTRUST_FROM: u32 = 3;
const WINDOW_NS: u64 = 1_000_000_000;

/// A frame as it arrived.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrival {
    pub(crate) now_ns: u64,
    pub(crate) port: u16,
    pub(crate) number: i32,
    /// The server's clock in ticks; 0 if unknown.
    pub(crate) ticks: u64,
    /// Digest of all bytes of the frame.
    pub(crate) digest: u64,
}

/// What a frame says of the sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Evidence {
    /// It can be the server.
    Agrees,
    /// Another port, or other content for the same number: the frame is dropped.
    OtherSender,
    /// Number or clock are ahead of what can be. Frames that go on from there mean that the
    /// server started again.
    AheadOfTime,
}

/// The last frame that agreed, and the contradictions since.
#[derive(Clone, Debug, Default)]
pub(crate) struct Consistency {
    last: Option<Arrival>,
    ns_per_tick: Option<f64>,
    recent: u32,
    since_ns: u64,
    distrusted_until_ns: u64,
}

impl Consistency {
    pub(crate) fn new(ticks_per_second: Option<NonZeroU64>) -> Self {
        Self {
            ns_per_tick: ticks_per_second.map(|ticks| 1e9 / ticks.get() as f64),
            ..Self::default()
        }
    }

    /// Compares a frame with the last one. A stream that was silent for longer than
    /// `stale_after_ns` may go on from another port.
    pub(crate) fn judge(&self, arrival: &Arrival, stale_after_ns: u64) -> Evidence {
        let Some(last) = &self.last else {
            return Evidence::Agrees;
        };
        let elapsed_ns = arrival.now_ns.saturating_sub(last.now_ns);
        if arrival.port != last.port && elapsed_ns <= stale_after_ns {
            return Evidence::OtherSender;
        }
        let ahead = arrival.number.wrapping_sub(last.number);
        if ahead == 0 && arrival.digest != last.digest {
            return Evidence::OtherSender;
        }
        let ns_per_tick = self.ns_per_tick.filter(|_| last.ticks != 0);
        let ticks = arrival.ticks.checked_sub(last.ticks);
        let (Some(ns_per_tick), Some(ticks)) = (ns_per_tick, ticks) else {
            return Evidence::Agrees;
        };
        let server_ns = ticks as f64 * ns_per_tick;
        let too_late = server_ns > elapsed_ns.saturating_add(AHEAD_NS) as f64;
        let too_many = f64::from(ahead) > BURST + server_ns * 1e-9 * MAX_FRAMES_PER_S;
        if too_late || too_many {
            Evidence::AheadOfTime
        } else {
            Evidence::Agrees
        }
    }

    /// The frame was taken as the newest.
    pub(crate) const fn taken(&mut self, arrival: Arrival) {
        self.last = Some(arrival);
    }

    /// Counts a contradiction; true if the frames are distrusted from now on and were not
    /// before.
    pub(crate) fn contradicted(&mut self, now_ns: u64) -> bool {
        if now_ns.saturating_sub(self.since_ns) > WINDOW_NS {
            self.since_ns = now_ns;
            self.recent = 0;
        }
        self.recent = self.recent.saturating_add(1);
        if self.recent < DISTRUST_FROM {
            return false;
        }
        let began = !self.is_distrusted(now_ns);
        self.distrusted_until_ns = now_ns.saturating_add(WINDOW_NS);
        began
    }

    pub(crate) const fn is_distrusted(&self, now_ns: u64) -> bool {
        now_ns < self.distrusted_until_ns
    }
}

/// FNV-1a of a datagram: it distinguishes contents; it is not cryptographic.
pub(crate) fn digest(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    })
}
