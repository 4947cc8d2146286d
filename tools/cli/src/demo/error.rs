//! Why a demo failed.

use singletrack_core::ConfigError;
use singletrack_pilot::{Mode, Reason};
use singletrack_scenario::{virtual_drive::VirtualDriveError, virtual_record::VirtualRecordError};
use singletrack_sim::RealTimeError;
use singletrackd::{StartError, StopError};

use singletrack_figures::plot::PlotError;

/// Why a demo failed.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// Ctrl-C.
    #[error("interrupted")]
    Interrupted,
    /// The simulator does not run.
    #[error("the simulator: {0}")]
    Simulator(#[from] RealTimeError),
    /// The UNO's image, or the processor that it ran on.
    #[error("the board: {0}")]
    Board(String),
    /// The daemon rejects its configuration.
    #[error("the configuration: {0}")]
    Config(#[from] ConfigError),
    /// The car that was chosen can't be simulated.
    #[error("the simulated car: {0}")]
    Car(#[from] singletrack_sim::ConfigError),
    /// The file of the car that was chosen.
    #[error("the simulated car: {0}")]
    CarFile(#[from] toml::de::Error),
    /// The configuration can't be written as TOML.
    #[error("the configuration: {0}")]
    Toml(#[from] toml::ser::Error),
    /// The daemon does not start.
    #[error("the daemon: {0}")]
    Start(#[from] StartError),
    /// The daemon did not end well.
    #[error("the daemon: {0}")]
    Stop(#[from] StopError),
    /// The page can't be served.
    #[error(transparent)]
    Page(#[from] singletrack_viewers::page::PageError),
    /// There are no figures of the drive.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// The drive in virtual time does not start.
    #[error(transparent)]
    Virtual(#[from] VirtualDriveError),
    /// Its record can't be written.
    #[error(transparent)]
    VirtualRecord(#[from] VirtualRecordError),
    /// The daemon takes no requests.
    #[error("the daemon: {0}")]
    Stalled(#[from] singletrack_core::Stalled),
    /// The car was never ready, or did not start.
    #[error(
        "the car did not start within {seconds} s: mode {mode}{}",
        because(*reason)
    )]
    NotStarted {
        /// The mode that it stayed in.
        mode: Mode,
        /// Why.
        reason: Option<Reason>,
        /// How long it was given.
        seconds: u64,
    },
    /// Anything else: a text which says what to do.
    #[error("{0}")]
    Other(String),
}

/// The reason, beside a mode.
pub(super) fn because(reason: Option<Reason>) -> String {
    reason.map_or_else(String::new, |reason| format!(" ({reason})"))
}
