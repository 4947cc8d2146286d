//! The command line of Singletrack, as a library for its tests.

pub mod simulate;
