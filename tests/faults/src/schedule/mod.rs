//! What a drive begins with, what is asked of it, and what goes wrong.

mod generate;
mod kind;
mod text;

use singletrack_sim::BoardKind;

pub use kind::{FaultKind, FaultTarget};
pub use text::ScheduleError;

/// Everything that decides how a drive goes: the same schedule gives the same
/// bits. Times are milliseconds since everything was switched on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// From this all noise follows, of the world and of its faults.
    pub seed: u64,
    /// What it begins with.
    pub situation: Situation,
    /// How long it lasts.
    pub end_ms: u32,
    /// What people ask for, in order of time.
    pub requests: Vec<ScheduledRequest>,
    /// What goes wrong.
    pub faults: Vec<Fault>,
}

/// What a drive begins with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Situation {
    /// What runs on the board.
    pub board: BoardKind,
    /// Where P should be.
    pub reference: ReferenceKind,
    /// How fast P should move, in mm/s.
    pub speed_mm_s: u32,
    /// Whether the estimate coasts on the IMU while the markers are lost, or
    /// holds the last pose.
    pub coast: bool,
    /// Whether the board brakes when it stops the car by itself.
    pub brake: bool,
    /// Whether a stop switch is wired.
    pub stop_input: bool,
    /// Whether the board is reset whenever the host opens its port, as an UNO is
    /// through DTR.
    pub reset_on_open: bool,
    /// Whether a line that is stuck shows so in the length of its queue; a
    /// pseudo-terminal does not.
    pub queue_shows: bool,
    /// How far the fence is from where the reference goes, in mm.
    pub fence_mm: u32,
    /// From mid-exposure to the packet on the network, in ms.
    pub camera_latency_ms: u32,
    /// What every byte takes longer than its bits, in µs.
    pub serial_delay_us: u32,
    /// What the board's clock gains, in µs per second.
    pub board_skew_ppm: i32,
    /// What the board's clock shows when the board starts, in ms.
    pub board_clock_ms: u32,
}

/// Where P should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReferenceKind {
    /// Round a circle.
    Circle,
    /// Along a figure of eight.
    Eight,
    /// With one constant velocity after the other, open loop; has an end.
    Steps,
    /// Where a program says, by set-points: round a circle.
    External,
}

/// What a person asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatorRequest {
    /// Drive.
    Arm,
    /// Slow down, stop and disarm.
    Disarm,
    /// Emergency stop.
    Stop,
    /// Reload the configuration file, which now holds the other of two.
    Reload,
}

/// A person asks for something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScheduledRequest {
    /// For what.
    pub request: OperatorRequest,
    /// When.
    pub at_ms: u32,
}

/// Something goes wrong for a while.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// What.
    pub kind: FaultKind,
    /// When it begins.
    pub at_ms: u32,
    /// How long it lasts; of no meaning for what happens in a moment.
    pub for_ms: u32,
    /// How bad it is, 1 to 1000; see [`FaultKind`] for the meaning.
    pub severity: u32,
}

impl Fault {
    /// The worst severity.
    pub const WORST: u32 = 1_000;

    /// When it ends.
    #[must_use]
    pub const fn end_ms(&self) -> u32 {
        self.at_ms.saturating_add(self.for_ms)
    }
}
