//! Imports of small logs that the tests write, and what is judged of them; and of real ones, where they are.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "the helpers of tests may fail as tests do"
)]

mod bag;
mod bench;
mod dart;
mod errors;
mod judge;
mod record;
mod sensors;
mod steering;
