//! The program `singletrack-lab`, and all programs as one with outer loops of other crates.

use std::{
    env,
    ffi::{OsStr, OsString},
    path::Path,
    process::ExitCode,
};

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use singletrack::{arguments::take_negative_numbers, help::printable, lab};
use singletrack_campaign::{MergeArgs, run_merge};
use singletrack_core::config::{OwnLoopKind, link_own_loops};

use crate::{
    Result, benchmark, certify, compare, identify, install_files, judge, reproduce, stability,
};

/// The laboratory of Singletrack: compare, identify, judge, reproduce, analyse.
#[derive(Parser)]
#[command(name = "singletrack-lab", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Judge and identify the public logs of real cars, and predict those that are held out.
    Benchmark(benchmark::BenchmarkArgs),
    /// Write the certificate of a configuration's safety filter: the room that a stop needs.
    Certify(certify::CertifyArgs),
    /// Compare controllers on the simulated car: errors, intervals and stops.
    Compare(compare::CompareArgs),
    /// Print the completions of `singletrack` for a shell.
    Completions {
        /// The shell.
        shell: install_files::CompletedShell,
    },
    /// Identify the car's parameters from recorded drives.
    Identify(identify::IdentifyArgs),
    /// Say what the pilot would have said of a recorded drive: stops, and errors of its estimate.
    Judge(judge::JudgeArgs),
    /// Join the result files of a campaign's shards to the file that one process writes.
    ///
    /// The files come from --shard K/N --json FILE. Gaps, doubles, and files of different
    /// campaigns, options or builds are refused. --from of the command that wrote them prints the
    /// report.
    Merge(MergeArgs),
    /// Repeat the paper's experiments and analyses, and compare its claims with measured results.
    Reproduce(reproduce::ReproduceArgs),
    /// Compute where the steady motion is stable: eigenvalues, bifurcations, the sampled loop.
    Stability(stability::StabilityArgs),
    /// Write completions for bash, zsh and fish and the manual pages, for packages.
    #[command(hide = true)]
    InstallFiles(install_files::InstallFilesArgs),
}

/// Runs the command line of this process as the programs of Singletrack do, with these outer loops of
/// other crates: as `singletrackd` if that is its name or its first argument, and otherwise as
/// `singletrack`.
pub fn main_with(kinds: impl Into<Vec<OwnLoopKind>>) -> ExitCode {
    link_own_loops(kinds);
    let arguments: Vec<OsString> = env::args_os().collect();
    let is_daemon =
        |word: &OsString| Path::new(word).file_name() == Some(OsStr::new("singletrackd"));
    if let Some(index) = arguments.iter().take(2).position(is_daemon) {
        return singletrackd::program::main(arguments.into_iter().skip(index));
    }
    let is_named = |(name, _): (&str, &str)| arguments.get(1).is_some_and(|one| one == name);
    if lab::commands().any(is_named) {
        return main();
    }
    singletrack::program::main()
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    // As it is typed: `singletrack stability`.
    let mut command = take_negative_numbers(Cli::command()).bin_name("singletrack");
    let matches = command.get_matches_mut();
    let cli =
        Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command).exit());
    match run(&cli.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("singletrack: {}", printable(&error.to_string()));
            ExitCode::FAILURE
        }
    }
}

fn run(command: &Command) -> Result {
    match command {
        Command::Benchmark(args) => benchmark::run(args),
        Command::Certify(args) => certify::run(args),
        Command::Compare(args) => compare::run(args),
        Command::Completions { shell } => install_files::print(*shell, &Cli::command()),
        Command::Identify(args) => identify::run(args),
        Command::Judge(args) => judge::run(args),
        Command::Merge(args) => run_merge(args),
        Command::Reproduce(args) => reproduce::run(args),
        Command::Stability(args) => stability::run(args),
        Command::InstallFiles(args) => Ok(install_files::run(args, &Cli::command())?),
    }
}
