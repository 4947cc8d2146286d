//! The commands of the laboratory: `singletrack-lab`, which stands beside this program, runs them.

use std::{env, ffi::OsString, os::unix::process::CommandExt as _, path::PathBuf, process};

use clap::{Arg, Command};

/// The program.
const PROGRAM: &str = "singletrack-lab";

/// The commands that it has, each with what it is for.
const COMMANDS: &str = "\
benchmark   Judge and identify the public logs of real cars, and predict those that are held out
certify     Write the certificate of a configuration's safety filter: the room that a stop needs
compare     Compare controllers on the simulated car: errors, intervals and stops
completions Print the completions of `singletrack` for a shell
identify    Identify the car's parameters from recorded drives
judge       Say what the pilot would have said of a recorded drive: stops, and errors of its estimate
merge       Join the result files of a campaign's shards to the file that one process writes
reproduce   Repeat the paper's experiments and analyses, and compare its claims with measured results
stability   Compute where the steady motion is stable: eigenvalues, bifurcations, the sampled loop";

/// The commands, each with what it is for.
pub fn commands() -> impl Iterator<Item = (&'static str, &'static str)> {
    let rows = COMMANDS.lines().filter_map(|row| row.split_once(' '));
    rows.map(|(name, about)| (name, about.trim_start()))
}

/// Adds the commands to the list of all. What they take is their program's.
pub fn listed(mut command: Command) -> Command {
    for (name, about) in commands() {
        let any = Arg::new("arguments").num_args(0..);
        let any = any.trailing_var_arg(true).allow_hyphen_values(true);
        let one = Command::new(name).about(about).disable_help_flag(true);
        command = command.subcommand(one.arg(any));
    }
    command
}

/// Becomes the program with this process's own arguments, if the first names such a command; returns
/// only otherwise, and why the program does not start.
///
/// # Errors
///
/// The program is not there.
pub fn run() -> Result<(), String> {
    let arguments: Vec<OsString> = env::args_os().skip(1).collect();
    let is_named = |(name, _): (&str, &str)| arguments.first().is_some_and(|one| one == name);
    if !commands().any(is_named) {
        return Ok(());
    }
    let beside = env::current_exe().map(|own| own.with_file_name(PROGRAM));
    // Otherwise on the search path.
    let program = beside.ok().filter(|path| path.is_file());
    let program = program.unwrap_or_else(|| PathBuf::from(PROGRAM));
    let error = process::Command::new(&program).args(arguments).exec();
    Err(format!(
        "{} does not start: {error}; it has the commands for a desk: `cargo build --release -p \
         {PROGRAM}` builds it, beside this program",
        program.display()
    ))
}
