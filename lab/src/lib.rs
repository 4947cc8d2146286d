//! What a desk needs and a car does not: stability, identification, the reproduction of the paper's
//! experiments, the comparison of controllers, and the judgement of logs.

#![allow(
    clippy::disallowed_methods,
    reason = "figures and tables; the modules that plan simulated drives forbid it"
)]

pub mod benchmark;
pub mod certify;
pub mod compare;
pub mod identify;
pub mod install_files;
pub mod judge;
pub mod program;
pub mod reproduce;
pub mod stability;
pub mod table;
pub mod vehicle_file;

pub use singletrack_campaign::Result;

/// How to print a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// For a person.
    #[value(alias = "text")]
    Table,
    /// For a program: one JSON object, with every digit.
    Json,
}

/// Prints a text as it is.
fn print(text: &str) -> Result {
    singletrack_figures::output::print(text)
        .map_err(|error| format!("can't write to standard output: {error}").into())
}
