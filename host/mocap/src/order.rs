//! Decides which frame continues the stream: only the newest.

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
            self.accept(mark);
            return Order::Newest { lost: 0 };
        };
        let ahead = mark.ahead_of(newest);
        if ahead == 0 {
            return Order::Duplicate;
        }
        if ahead > 0 && clock >= newest.clock {
            self.accept(mark);
            return Order::Newest {
                lost: u64::from(ahead.unsigned_abs()) - 1,
            };
        }
        if ahead < 0 && clock > newest.clock {
            self.accept(mark);
            return Order::Renumbered;
        }
        self.suspect(number, clock)
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

    const fn accept(&mut self, mark: Mark) {
        self.newest = Some(mark);
        self.suspect = None;
        self.suspects = 0;
    }
}
