//! The studies, and the commands as they are typed.

#![allow(
    clippy::disallowed_methods,
    reason = "what a test expects is compared within a tolerance"
)]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test may fail"
)]

mod benchmark;
mod certify_command;
mod compare;
mod cycles;
mod identify_command;
mod install_files;
mod judge;
mod limit_cycles;
#[path = "../../tools/figures/tests/picture/mod.rs"]
mod picture;
#[path = "../../tools/cli/tests/recorded/mod.rs"]
mod recorded;
mod reproduce_command;
mod stability_command;
mod stability_figures;
mod study;
