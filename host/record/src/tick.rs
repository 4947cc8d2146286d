//! One tick of the control thread, as that thread tells it.

use singletrack_control::{Event, Output, Time};

/// The most events that a tick takes in; the control thread counts the rest as
/// dropped. Ten ticks' worth at the cameras' and the board's highest rates.
pub const MAX_EVENTS: usize = 64;

/// What a tick was given, what it decided, and when.
///
/// Without an allocation, so that the control thread can push it through a ring.
/// All times are nanoseconds on the host's monotonic clock.
#[derive(Clone, Debug, PartialEq)]
pub struct TickRecord {
    /// Counts the ticks of the daemon, from 0.
    pub index: u64,
    /// The point of the tick's grid that it belongs to.
    pub scheduled_ns: u64,
    /// When the thread woke up for it.
    pub start_ns: u64,
    /// When its command was decided and handed to the line.
    pub finish_ns: u64,
    /// Points of the grid that were skipped just before it, because the tick
    /// before took too long.
    pub skipped: u32,
    /// The moment that [`singletrack_control::Pilot::step`] was told.
    pub pilot_time: Time,
    /// The events that it was told, in order.
    pub events: heapless::Vec<Event, MAX_EVENTS>,
    /// Events since the tick before that did not fit: the pilot never saw them.
    pub events_dropped: u32,
    /// What it decided.
    pub output: Output,
    /// What became of its command; none if there was nothing to send.
    pub drive: Option<DriveWrite>,
    /// The session with the board.
    pub link: LinkPhase,
}

impl TickRecord {
    /// How much later than scheduled the thread woke up.
    #[must_use]
    pub const fn lateness_ns(&self) -> i64 {
        self.start_ns.wrapping_sub(self.scheduled_ns) as i64
    }

    /// From the mid-exposure of the newest accepted pose to the command that
    /// rests on it leaving for the board; none if none left.
    ///
    /// In a held tick the pose is an old one: ask [`Output::held`] before taking
    /// this for a latency.
    #[must_use]
    pub const fn capture_to_command_ns(&self) -> Option<i64> {
        match (&self.output.command, &self.drive) {
            (Some(command), Some(drive)) if drive.written => {
                Some(drive.time_ns.wrapping_sub(command.pose_time.0) as i64)
            }
            _ => None,
        }
    }
}

/// A drive command on its way to the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DriveWrite {
    /// The command's number on the wire.
    pub sequence: u8,
    /// Whether the whole frame was written; otherwise the line was full or
    /// closed and no byte of it was.
    pub written: bool,
    /// When that was known.
    pub time_ns: u64,
}

/// The session with the board, by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkPhase {
    /// The port is closed.
    Disconnected,
    /// The board is being greeted.
    Greeting,
    /// The board speaks another version of the protocol.
    VersionMismatch,
    /// The board has been sent its configuration.
    Configuring,
    /// The board does not take its configuration.
    ConfigurationRefused,
    /// The board has its configuration.
    Ready,
}
