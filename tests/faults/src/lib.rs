//! Random schedules of faults against everything that drives the car, in virtual
//! time.
//!
//! ```text
//! cargo faults --first-seed 1 --count 10000
//! cargo faults --first-seed 1 --count 200 --board uno     the Arduino's image, simulated
//! cargo faults --replay 'seed 7; end_ms 9000; ask arm at 3200; fault line-stuck at 6000 for 500 severity 1'
//! cargo faults --first-seed 7 --count 1 --print           the schedule of a seed
//! cargo faults --first-seed 7 --count 1 --record DIR      leaves what its daemons would record
//! ```
//!
//! The last line is `N schedules, V violations`; any violation makes it fail. It is
//! printed with the schedule that shows it, then shrunk: faults and requests are
//! left out, shortened and weakened as long as the same thing is broken. What is
//! left is printed as a command that replays it.
//!
//! # What is real
//!
//! The daemon's control loop with link session and pilot, its motion capture
//! session, its configuration, the rings between its threads and their sizes; the
//! board's code or the image; frames on a line paced at its baud rate, NatNet
//! packets. Retold are the loops of the daemon's other threads, the kernel's queues
//! of a port and a socket, and the network, which falsifies packets on their way.
//! Nothing reads a clock: the same schedule gives the same bits, on any number of
//! threads.
//!
//! # What a schedule is
//!
//! A situation (reference, speed, fence, latencies, clocks, what is wired), what
//! people ask for and when, and faults with onset, duration and severity: see
//! [`schedule::FaultKind`]. A seed makes one; a text can be written by hand, where every
//! key that is left out is as usual.
//!
//! # What must hold
//!
//! Every file in `invariant/` has a few, each with its limit and where it comes
//! from. They judge by what is really so: pulses on the pins, when a pose was
//! really exposed, where the car really is. `tests/planted.rs` plants a bug for
//! each and shows that it is found.
//!
//! To add a fault: a line in `schedule/kind.rs`, and what it does in `network.rs`,
//! `stage.rs` or `drive.rs`. To add an invariant: a type in `invariant/`, a line in
//! its list, a planted bug.

mod campaign;
mod daemon;
mod digest;
mod drive;
mod invariant;
mod network;
mod observation;
mod port;
mod program;
mod random;
mod recording;
pub mod schedule;
mod setting;
mod shrink;
mod stage;
mod tamper;

pub use campaign::{Campaign, CampaignOutcome, Failure, attempt};
pub use drive::{DriveOutcome, Violation, drive};
pub use recording::{Recording, RecordingError};
pub use shrink::shrink;
pub use tamper::{Tamper, Untampered};

/// Errors while setting up a drive.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// The daemon's configuration is invalid.
    #[error("the daemon's configuration: {0}")]
    Config(singletrack_core::ConfigError),
    /// Another part rejected its parameters.
    #[error("{part}: {reason}")]
    Other {
        /// The part, for the message.
        part: &'static str,
        /// The part's own error text.
        reason: String,
    },
}
