//! Random fault schedules against the complete control chain, in virtual time.
//!
//! ```text
//! cargo faults --first-seed 1 --count 10000
//! cargo faults --first-seed 1 --count 200 --board uno     the UNO image on a simulated processor
//! cargo faults --replay 'seed 7; end_ms 9000; ask arm at 3200; fault line-stuck at 6000 for 500 severity 1'
//! cargo faults --first-seed 7 --count 1 --print           print the schedule of a seed
//! cargo faults --first-seed 7 --count 1 --record DIR      write the records of its daemons
//! cargo faults --planted --count 200                      count in how many schedules each planted bug is found
//! cargo faults --count 10000 --shard 1/4 --json FILE      a part of a campaign: see `singletrack-campaign`
//! cargo faults --cars 3 --count 1000                      several cars: no two may touch
//! cargo faults --from FILE...                             the report on a campaign that was run in parts
//! ```
//!
//! The last line is `N schedules, V violations`; the command fails if V is not
//! zero. Each violation is printed with its schedule. The schedule is then shrunk:
//! faults and requests are removed, shortened and weakened as long as the same
//! invariant is violated. The result is printed as a command that replays it.
//!
//! # What is real
//!
//! Real are the daemon's host loop (serial reader, camera receiver, control loop with
//! link session and pilot, rings, alignment of the ticks, reconfiguration) and its
//! configuration; the board's code or the image; frames on a line paced at its baud
//! rate; NatNet packets. Modelled are the kernel's queues of a port and a socket, and
//! the network, which falsifies packets. Nothing reads a clock: the same schedule
//! gives the same bits on any number of threads.
//!
//! # Schedules
//!
//! A schedule holds a situation (what is configured: reference, speed, geofence,
//! ESC, ...; latencies, clocks, wiring), the true car where it differs from that (see
//! [`schedule::Deviation`]), operator requests with their times, and faults with onset,
//! duration and severity: see [`schedule::FaultKind`]. It is generated from a seed or written by
//! hand; keys that are left out keep their defaults.
//!
//! # Invariants
//!
//! Every file in `invariant/` defines some, each with its limit and the reason for
//! it. They are checked against ground truth: pulses on the pins, exposure times of
//! poses, the true position of the car. What they allow comes from the configuration.
//! [`planted::BUGS`] has a bug for each, and `tests/planted.rs` checks that it is found.
//!
//! To add a fault: a line in `schedule/kind.rs` and its effect in `network.rs`,
//! `setting.rs` or `drive/`. To add a property of the car: a line in
//! `schedule/mod.rs` and its effect in `setting.rs`. To add an invariant: a type in
//! `invariant/`, a line in its list, a planted bug.

mod campaign;
mod daemon;
mod drive;
mod fleet;
mod invariant;
mod network;
mod observation;
mod pins;
pub mod planted;
mod program;
mod random;
pub mod schedule;
mod setting;
mod spec;
mod stop;
mod tamper;

pub use campaign::{Campaign, CampaignOutcome, Failure, ReadError, SeedOutcome, attempt, shrink};
pub use daemon::{Recording, RecordingError};
pub use drive::{DriveOutcome, FilterTicks, Until, Violation, drive, drive_watched};
pub use fleet::{FleetBug, FleetCampaign, FleetOutcome, drive_fleet};
pub use invariant::names;
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
