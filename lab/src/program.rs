//! The program `singletrack-lab` with its small commands, and all programs as one with outer loops of other
//! crates.

use std::{
    env,
    ffi::{OsStr, OsString},
    fs, io,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand, ValueEnum};
use clap_complete::{Shell, generate, generate_to};
use singletrack::{arguments::take_negative_numbers, help::printable, lab};
use singletrack_campaign::{MergeArgs, run_merge};
use singletrack_core::{
    Config,
    certificate::certificate,
    config::{OwnLoopKind, link_own_loops},
};

use crate::{Result, benchmark, compare, identify, judge, print, reproduce, stability};

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
    Certify(CertifyArgs),
    /// Compare controllers on the simulated car: errors, intervals and stops.
    Compare(compare::CompareArgs),
    /// Print the completions of `singletrack` for a shell.
    Completions {
        /// The shell.
        shell: CompletedShell,
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
    InstallFiles(InstallFilesArgs),
}

/// Options of `singletrack certify`.
#[derive(Clone, Debug, Args)]
struct CertifyArgs {
    /// The car's configuration, as the daemon takes it.
    config: PathBuf,

    /// Where the certificate goes: the file of `safety_filter.certificate`.
    #[arg(
        long,
        value_name = "FILE.json",
        default_value = "filter-certificate.json"
    )]
    out: PathBuf,
}

/// Options of `singletrack-lab install-files`.
#[derive(Clone, Debug, Args)]
struct InstallFilesArgs {
    /// The folder for them; it gets one each for bash, zsh, fish and man
    #[arg(long, value_name = "DIR", default_value = "target/install-files")]
    out: PathBuf,
}

/// A shell with completions.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum CompletedShell {
    /// Write it to `~/.local/share/bash-completion/completions/singletrack`.
    Bash,
    /// Write it to a folder of `fpath`, as `_singletrack`.
    Zsh,
    /// Write it to `~/.config/fish/completions/singletrack.fish`.
    Fish,
}

impl CompletedShell {
    const fn shell(self) -> Shell {
        match self {
            Self::Bash => Shell::Bash,
            Self::Zsh => Shell::Zsh,
            Self::Fish => Shell::Fish,
        }
    }
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
        Command::Certify(args) => certify(args),
        Command::Compare(args) => compare::run(args),
        Command::Completions { shell } => print_completions(*shell),
        Command::Identify(args) => identify::run(args),
        Command::Judge(args) => judge::run(args),
        Command::Merge(args) => run_merge(args),
        Command::Reproduce(args) => reproduce::run(args),
        Command::Stability(args) => stability::run(args),
        Command::InstallFiles(args) => Ok(install_files(args)?),
    }
}

/// Writes the certificate of the safety filter, for a configuration.
fn certify(args: &CertifyArgs) -> Result {
    let text = certificate(&Config::read(&args.config)?)?;
    let path = args.out.display();
    Ok(fs::write(&args.out, text).map_err(|error| format!("can't write {path}: {error}"))?)
}

/// Prints the completions of `singletrack`, with the commands of the laboratory.
fn print_completions(shell: CompletedShell) -> Result {
    let mut text = Vec::new();
    let mut command = singletrack();
    generate(shell.shell(), &mut command, "singletrack", &mut text);
    print(&String::from_utf8_lossy(&text))
}

/// `singletrack` with the commands of the laboratory, and without the subcommands that its help does not
/// show, which completions do.
fn singletrack() -> clap::Command {
    let lab = Cli::command();
    let commands = lab.get_subcommands().cloned();
    let command = singletrack::program::command().subcommands(commands);
    let subcommands = command.get_subcommands().filter(|one| !one.is_hide_set());
    let mut shown = clap::Command::new("singletrack")
        .version(env!("CARGO_PKG_VERSION"))
        .args(command.get_arguments().cloned())
        .subcommands(subcommands.cloned());
    if let Some(about) = command.get_about() {
        shown = shown.about(about.clone());
    }
    if let Some(text) = command.get_after_long_help() {
        shown = shown.after_long_help(text.clone());
    }
    shown
}

/// Writes the files for `singletrack`, with the commands of the laboratory, for `singletrackd` and for
/// `singletrack-sim`: completions for shells and manual pages, from the description of the options itself.
fn install_files(args: &InstallFilesArgs) -> Result<(), String> {
    for command in [
        &singletrack(),
        &singletrackd::Arguments::command(),
        &singletrack_sim::Arguments::command(),
    ] {
        let name = command.get_name();
        for shell in CompletedShell::value_variants() {
            let shell = shell.shell();
            write_to(&args.out.join(shell.to_string()), |folder| {
                generate_to(shell, &mut command.clone(), name, folder).map(drop)
            })?;
        }
        write_to(&args.out.join("man"), |folder| {
            clap_mangen::generate_to(command.clone(), folder)
        })?;
    }
    // Its commands have their pages as those of `singletrack`, as which they are typed.
    let mut own = clap::Command::new("singletrack-lab")
        .version(env!("CARGO_PKG_VERSION"))
        .after_help("Its commands are typed as `singletrack COMMAND`: see singletrack(1).");
    if let Some(about) = Cli::command().get_about() {
        own = own.about(about.clone());
    }
    write_to(&args.out.join("man"), |folder| {
        clap_mangen::generate_to(own, folder)
    })
}

fn write_to(folder: &Path, write: impl FnOnce(&Path) -> io::Result<()>) -> Result<(), String> {
    fs::create_dir_all(folder)
        .and_then(|()| write(folder))
        .map_err(|error| {
            let folder = folder.display();
            format!("can't write to {folder}: {error}; choose another folder with --out")
        })
}
