//! The pilot in virtual time.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]

mod bench;
mod bits;
mod fence;
mod losses;
mod outer_loops;
mod pilot;
mod safety;
mod setpoints;
mod tuning;
mod watched;
