//! The command line of Singletrack, as a library for its tests.

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
pub mod jog;
pub mod recover;
pub mod replay;
pub mod set_reference;
pub mod setpoint;
pub mod teach;

mod interrupt;
