//! The board in virtual time.

mod actuators;
mod arming;
mod brake;
mod commands;
mod gears;
mod invariants;
mod jogging;
mod kill_output;
mod reporting;
mod rig;
mod stopping;
mod watches;
