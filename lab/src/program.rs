//! The program `singletrack-lab`, whose commands `singletrack` passes on.

use std::{error::Error, process::ExitCode};

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use singletrack::{arguments::take_negative_numbers, help::printable};
use singletrack_campaign::{MergeArgs, run_merge};

use crate::{benchmark, compare, identify, install_files, judge, reproduce, stability};

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

/// Runs the command line of this process.
#[must_use]
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

fn run(command: &Command) -> Result<(), Box<dyn Error>> {
    match command {
        Command::Benchmark(args) => benchmark::run(args)?,
        Command::Compare(args) => compare::run(args)?,
        Command::Completions { shell } => install_files::print(*shell, &Cli::command())?,
        Command::Identify(args) => identify::run(args)?,
        Command::Judge(args) => judge::run(args)?,
        Command::Merge(args) => run_merge(args)?,
        Command::Reproduce(args) => reproduce::run(args)?,
        Command::Stability(args) => stability::run(args)?,
        Command::InstallFiles(args) => install_files::run(args, &Cli::command())?,
    }
    Ok(())
}
