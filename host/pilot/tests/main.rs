//! The pilot in virtual time.

mod bench;
mod bits;
mod fence;
mod fenced;
mod outer_loops;
mod pilot;
mod safety;
mod tuning;
mod watched;
