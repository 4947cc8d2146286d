//! The project's own commands, each an alias in `.cargo/config.toml`:
//! `cargo deb`, `cargo demo`, `cargo faults`, `cargo odroid`, `cargo onboard`, `cargo uno`,
//! `cargo verify`.
//!
//! It has no dependencies, so that it runs on a machine with only a Rust toolchain.

mod beside;
mod deb;
mod demo;
mod faults;
mod gates;
mod image;
mod libraries;
mod odroid;
mod onboard;
mod packages;
mod prerequisites;
mod process;
mod publish;
mod python;
mod readers;
mod release;
mod ros;
mod same_bits;
mod slurm;
mod step;
mod target;
mod toolchain;
mod units;
mod uno;
mod verify;
mod workspace;

use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some((command, arguments)) = arguments.split_first() else {
        eprintln!(
            "usage: cargo deb | demo | faults | odroid | onboard | uno | verify, each with --help"
        );
        return ExitCode::FAILURE;
    };
    let result = workspace::find().and_then(|_| match command.as_str() {
        "deb" => deb::main(arguments),
        "demo" => demo::main(arguments),
        "faults" => faults::main(arguments),
        "onboard" => onboard::main(arguments),
        "uno" => uno::main(arguments),
        "odroid" => odroid::main(arguments),
        "verify" => verify::main(arguments),
        unknown => Err(process::Failure::new(format!(
            "unknown command {unknown:?}; known: cargo deb | demo | faults | odroid | onboard | uno | verify"
        ))),
    });
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("\n{command}: {failure}");
            ExitCode::FAILURE
        }
    }
}
