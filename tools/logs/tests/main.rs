//! Imports of small logs that the tests write.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

mod bench;
mod dart;
mod errors;
mod record;
mod sensors;
mod steering;
