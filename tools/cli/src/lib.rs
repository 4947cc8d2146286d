//! The command line of Singletrack, as a library for its tests.

pub mod arguments;
pub mod arm;
pub mod bench;
pub mod bring_up;
pub mod calibrate;
pub mod control;
#[cfg(feature = "desk")]
pub mod demo;
pub mod doctor;
pub mod drive;
pub mod dump;
pub mod install_files;
pub mod jog;
pub mod recover;
pub mod replay;
pub mod set_reference;
pub mod setpoint;
pub mod status;
pub mod teach;
pub mod tune;

mod interrupt;
mod terminal;
