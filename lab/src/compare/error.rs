//! Why a drive can't be compared.

use singletrack_control::LawError;
use singletrack_core::ConfigError;
use singletrack_scenario::virtual_drive::VirtualDriveError;

/// Why a drive can't be simulated.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The reference is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The host or the world is refused.
    #[error(transparent)]
    Drive(#[from] VirtualDriveError),
    /// The law of the appendix has no limits and no start from standstill.
    #[error("the law of the appendix drives the ideal plant only; choose condition ideal-plant")]
    IdealPlantOnly,
    /// A program's own controller is driven by that program.
    #[error("a controller of your own is compared by the Python package")]
    Yours,
    /// A law is refused.
    #[error(transparent)]
    Law(#[from] LawError),
}
