//! The project's own commands, each an alias in `.cargo/config.toml`:
//! `cargo deb`, `cargo demo`, `cargo explore`, `cargo faults`, `cargo odroid`, `cargo onboard`,
//! `cargo release`, `cargo uno`, `cargo verify`, `cargo web`.
//!
//! It has no dependencies, so that it is built in seconds.

mod deb;
mod notes;
mod odroid;
mod prerequisites;
mod process;
mod programs;
mod python;
mod release;
mod step;
mod uno;
mod verify;
mod web;
mod workspace;

use std::process::ExitCode;

use process::Result;
use programs::become_program;

const COMMANDS: &str =
    "cargo deb | demo | explore | faults | odroid | onboard | release | uno | verify | web";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some((command, arguments)) = arguments.split_first() else {
        eprintln!("usage: {COMMANDS}, each with --help");
        return ExitCode::FAILURE;
    };
    let result = workspace::find().and_then(|_| match command.as_str() {
        "deb" => run(deb::USAGE, arguments, deb::main),
        "demo" => programs::demo(arguments),
        "explore" => become_program("singletrack-exploration", "--", arguments),
        "faults" => become_program("singletrack-faults", "--", arguments),
        "onboard" => become_program("singletrack-onboard", "--", arguments),
        "uno" => run(uno::USAGE, arguments, uno::main),
        "odroid" => run(odroid::USAGE, arguments, odroid::main),
        "release" => run(release::USAGE, arguments, release::main),
        "verify" => run(&verify::usage(), arguments, verify::main),
        "web" => run(web::USAGE, arguments, web::main),
        unknown => Err(process::failure!(
            "unknown command {unknown:?}; known: {COMMANDS}"
        )),
    });
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("\n{command}: {failure}");
            failure.status.into()
        }
    }
}

/// Runs a command, or prints its help if its arguments ask for that.
fn run(usage: &str, arguments: &[String], command: fn(&[String]) -> Result) -> Result {
    if arguments.iter().any(|one| one == "--help" || one == "-h") {
        print!("{usage}");
        return Ok(());
    }
    command(arguments)
}

/// Options with their values, if any, and other words. The options in `valued` have a value, after `=` or
/// as the next argument.
pub(crate) fn options<'a>(
    arguments: &'a [String],
    valued: &[&str],
) -> Vec<(&'a str, Option<&'a str>)> {
    let mut rest = arguments.iter().map(String::as_str);
    let next = || match rest.next()? {
        option if valued.contains(&option) => Some((option, rest.next())),
        argument => match argument.split_once('=') {
            Some((option, value)) if valued.contains(&option) => Some((option, Some(value))),
            _ => Some((argument, None)),
        },
    };
    std::iter::from_fn(next).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_with_help_among_its_arguments_does_nothing_else() {
        let ran = |line: &str| {
            let arguments: Vec<String> = line.split(' ').map(str::to_owned).collect();
            run("", &arguments, |_| Err(process::failure!("it ran"))).is_err()
        };
        assert!(!ran("--help"));
        assert!(!ran("-h"));
        assert!(!ran("--all --help"));
        assert!(ran("--all"));
    }
}
