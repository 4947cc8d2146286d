//! The project's own commands, each an alias in `.cargo/config.toml`:
//! `cargo demo`, `cargo faults`, `cargo uno`, `cargo odroid`, `cargo verify`.
//!
//! It depends on nothing, so that it is there at once on a machine that has
//! nothing but a Rust toolchain.

mod debian;
mod debian_cargo;
mod demo;
mod faults;
mod figures;
mod gates;
mod image;
mod odroid;
mod packages;
mod readers;
mod same_bits;
mod step;
mod target;
mod units;
mod uno;
mod verify;

use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some((command, arguments)) = arguments.split_first() else {
        eprintln!("usage: cargo demo | faults | uno | odroid | verify, each with --help");
        return ExitCode::FAILURE;
    };
    let result = match command.as_str() {
        "demo" => demo::main(arguments),
        "faults" => faults::main(arguments),
        "uno" => uno::main(arguments),
        "odroid" => odroid::main(arguments),
        "verify" => verify::main(arguments),
        _ => {
            eprintln!("there is no {command:?}: cargo demo | faults | uno | odroid | verify");
            return ExitCode::FAILURE;
        }
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("\n{command}: {failure}");
            ExitCode::FAILURE
        }
    }
}
