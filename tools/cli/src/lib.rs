//! The command line of Singletrack, as a library for its tests and for `singletrack-lab`.

pub mod arguments;
pub mod demo;
pub mod help;
pub mod lab;
#[cfg(feature = "operator")]
pub mod operator;
pub mod program;
pub mod progress;
pub mod viewers;

mod interrupt;

/// What a command does, or why not, in words for the user.
pub type Result<T, E = Box<dyn std::error::Error>> = std::result::Result<T, E>;
