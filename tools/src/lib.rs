//! The command line of Singletrack, as a library for its tests.

pub mod control;
pub mod demo;
pub mod dump;
pub mod estimation;
pub mod figure;
pub mod identify;
pub mod plot;
pub mod recover;
pub mod replay;
pub mod reproduce;
pub mod set_reference;
pub mod setpoint;
pub mod simulate;
pub mod simulated;
pub mod stability;
pub mod tracking;
pub mod vehicle_file;
pub mod virtual_drive;
pub mod virtual_record;

mod interrupt;
mod template;
