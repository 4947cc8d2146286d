//! The project's own commands, each an alias in `.cargo/config.toml`:
//! `cargo deb`, `cargo demo`, `cargo explore`, `cargo faults`, `cargo odroid`, `cargo onboard`,
//! `cargo release`, `cargo uno`, `cargo verify`.
//!
//! It has no dependencies, so that it is built in seconds.

mod changelog;
mod deb;
mod gates;
mod image;
mod libraries;
mod odroid;
mod once;
mod packages;
mod prerequisites;
mod process;
mod programs;
mod python;
mod release;
mod ros;
mod shell;
mod step;
mod target;
mod toolchain;
mod units;
mod uno;
mod verify;
mod workspace;
mod yardstick;

use std::process::ExitCode;

use process::{Failure, NOT_VALID};

const COMMANDS: &str =
    "cargo deb | demo | explore | faults | odroid | onboard | release | uno | verify";

fn main() -> ExitCode {
    if let Some(code) = once::called(std::env::args()) {
        return code;
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some((command, arguments)) = arguments.split_first() else {
        eprintln!("usage: {COMMANDS}, each with --help");
        return ExitCode::FAILURE;
    };
    let result = workspace::find().and_then(|_| match command.as_str() {
        "deb" => deb::main(arguments),
        "demo" => programs::DEMO.run(arguments),
        "explore" => programs::EXPLORE.run(arguments),
        "faults" => programs::FAULTS.run(arguments),
        "onboard" => programs::ONBOARD.run(arguments),
        "uno" => uno::main(arguments),
        "odroid" => odroid::main(arguments),
        "release" => release::main(arguments),
        "verify" => verify::main(arguments),
        unknown => Err(process::failure!(
            "unknown command {unknown:?}; known: {COMMANDS}"
        )),
    });
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("\n{command}: {failure}");
            match failure {
                Failure::Failed(_) => ExitCode::FAILURE,
                Failure::NotValid(_) => NOT_VALID.into(),
            }
        }
    }
}
