//! The command line of Singletrack, as a library for its tests.

pub mod control;
#[cfg(feature = "desk")]
pub mod demo;
pub mod dump;
pub mod estimation;
pub mod figure;
#[cfg(feature = "desk")]
pub mod identify;
#[cfg(feature = "desk")]
pub mod plot;
pub mod recover;
pub mod replay;
#[cfg(feature = "desk")]
pub mod reproduce;
pub mod set_reference;
pub mod setpoint;
pub mod simulate;
pub mod simulated;
#[cfg(feature = "desk")]
pub mod stability;
pub mod tracking;
#[cfg(feature = "desk")]
pub mod vehicle_file;
pub mod virtual_drive;
pub mod virtual_record;

mod csv_text;
mod interrupt;
#[cfg(feature = "desk")]
mod template;
