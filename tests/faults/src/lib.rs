//! Random schedules of faults against everything that drives the car, in virtual
//! time.

mod campaign;
mod daemon;
mod digest;
mod drive;
mod invariant;
mod network;
mod port;
mod random;
pub mod schedule;
mod setting;
mod shrink;
mod sight;
mod stage;
mod tamper;

pub use campaign::{Campaign, Failure, Outcome, attempt};
pub use drive::{Ending, Violation, drive};
pub use shrink::shrink;
pub use tamper::{Tamper, Untampered};

/// What keeps a drive from being set up.
#[derive(Debug, thiserror::Error)]
pub enum Trouble {
    /// The daemon's configuration.
    #[error("the daemon's configuration: {0}")]
    Config(singletrackd::ConfigError),
    /// Something else.
    #[error("{what}: {reason}")]
    Setting {
        /// What.
        what: &'static str,
        /// Why.
        reason: String,
    },
}
