//! The command line of Singletrack, as a library for its tests.

#[cfg(feature = "operator")]
pub mod accept;
pub mod arguments;
#[cfg(feature = "operator")]
pub mod arm;
#[cfg(feature = "operator")]
pub mod bench;
#[cfg(feature = "operator")]
pub mod cameras;
#[cfg(feature = "operator")]
pub mod control;
#[cfg(feature = "demo")]
pub mod demo;
#[cfg(feature = "operator")]
pub mod drive;
#[cfg(feature = "operator")]
pub mod dump;
#[cfg(feature = "operator")]
pub mod fleet;
pub mod help;
#[cfg(feature = "operator")]
pub mod import;
#[cfg(feature = "operator")]
pub mod install_files;
#[cfg(feature = "operator")]
pub mod jog;
pub mod printable;
#[cfg(feature = "operator")]
pub mod recover;
#[cfg(feature = "operator")]
pub mod replay;
#[cfg(feature = "operator")]
pub mod set_reference;
#[cfg(feature = "operator")]
pub mod setpoint;
#[cfg(feature = "operator")]
pub mod status;
#[cfg(feature = "operator")]
pub mod teach;
#[cfg(feature = "operator")]
pub mod tune;
#[cfg(any(feature = "live", feature = "page"))]
pub mod viewers;

#[cfg(any(feature = "live", feature = "operator", feature = "page"))]
mod interrupt;
#[cfg(any(feature = "demo", feature = "operator"))]
mod progress;
#[cfg(feature = "operator")]
mod readable;
#[cfg(feature = "operator")]
mod terminal;
mod wrap;
